"""What the pages draw: figures as data, made of values; nothing here knows of pages."""
