"""Hardware behind two callbacks: the bench itself, its interlocks, its pacing and how it ends."""
