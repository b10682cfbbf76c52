"""Many axes at once: a fleet's runs on this machine or on a cluster, and what they say of the fleet."""
