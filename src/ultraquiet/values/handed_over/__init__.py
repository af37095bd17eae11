"""What verbs are handed: records, responses and models, checked in one place."""
