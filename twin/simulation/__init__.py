"""The compiled kernel that simulates and predicts an axis."""
