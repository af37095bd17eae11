"""H2 synthesis: LQG and loop transfer recovery."""
