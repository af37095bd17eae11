"""The TMS320C31: its cycle model, its number format and its assembly."""
