"""The vocabulary of physics: one page an effect, listed in the catalogue."""
