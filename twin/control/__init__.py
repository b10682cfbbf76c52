"""The controller: design from a model, robustness, co-simulation against the FMU."""
