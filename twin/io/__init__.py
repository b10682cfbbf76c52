"""Files in and out: recordings, rig files, manifests, faults of a log."""
