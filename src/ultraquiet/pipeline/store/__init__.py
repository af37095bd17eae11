"""The folder of a study as a store: one run at a time, stages whole or not at all, records that stay."""
