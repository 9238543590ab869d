"""`make bench`: how fast everything is on this machine, in ratios and medians; no wall clock judges speed elsewhere."""
