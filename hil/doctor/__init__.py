"""Is this place fit for a run? What `hil doctor` reads, how it judges what it read, and how to mend it."""
