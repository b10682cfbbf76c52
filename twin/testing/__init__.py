"""A twin under test: pass or fail against a recording, and the pytest fixture."""
