"""Runs under the rule `functional` for studies: the whole loop in one call, and what both ways to run it leave."""
