"""What a hand can do to a study, how it is kept and repeated; nothing here knows of pages."""
