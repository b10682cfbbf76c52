"""The laws of the model written out in Python, C, Modelica and LaTeX."""
