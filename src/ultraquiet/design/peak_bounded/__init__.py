"""Laws searched for on several models of a plant at once, their peak of amplification bounded."""
