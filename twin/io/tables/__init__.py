"""Tables as they lie on disk, one reader a file format. `formats.open_tables` opens any of them."""
