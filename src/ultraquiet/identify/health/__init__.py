"""Which channels of records are dead or saturated, judged by the records alone."""
