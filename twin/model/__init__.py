"""The model: its structure, its equations of motion, its parameter values."""
