"""The frame that a law runs in: its settings, its times, its clock, its overloads."""
