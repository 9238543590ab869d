"""The joint CPU's 8086: machine code run, counted and bounded."""
