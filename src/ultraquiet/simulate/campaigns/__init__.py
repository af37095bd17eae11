"""Thousands of benches, each drawn afresh: evaluated on all cores or on a cluster, each result sealed at once."""
