"""What goes into FMUs: the plumbing of the standard, which knows no physics."""
