"""How numbers, units and tables are written, for terminal, notebook and report alike."""
