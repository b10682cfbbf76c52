"""Writers: one physical text in, one tongue out each."""
