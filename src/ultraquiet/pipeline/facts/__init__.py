"""What the stages of a study tell each other: facts by frozen dataclasses, values by the names of their files."""
