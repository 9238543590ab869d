"""What the target computers run: word arithmetic, the joint CPU, the DSP."""
