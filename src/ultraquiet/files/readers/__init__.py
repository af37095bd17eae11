"""Files of other programs: one file a format, with its reader and, where it keeps what a record holds, its writer."""
