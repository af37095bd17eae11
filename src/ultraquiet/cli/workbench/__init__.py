"""`ultraquiet serve`."""
