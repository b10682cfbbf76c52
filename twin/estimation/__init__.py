"""Parameters from recordings: two-stage estimate, maximum likelihood, uncertainty."""
