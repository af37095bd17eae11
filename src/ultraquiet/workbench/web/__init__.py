"""The pages: NiceGUI on 127.0.0.1, behind a token."""
