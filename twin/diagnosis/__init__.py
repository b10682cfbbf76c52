"""What a model leaves out: where it errs, which effect explains it, how sure that is."""
