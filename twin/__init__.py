"""twin: from one recording of a motor-driven axis to its digital twin."""
