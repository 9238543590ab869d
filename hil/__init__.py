"""The bench: the wire, the clocks, the rig, the records, the reports, the command line."""
