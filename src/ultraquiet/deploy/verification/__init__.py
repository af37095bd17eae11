"""The proof of generated code: here, on emulated processors, under random bits, in the loop."""
