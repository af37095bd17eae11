"""Charts of a study as its page draws them; still pictures are made from the same (`plot.page`)."""
