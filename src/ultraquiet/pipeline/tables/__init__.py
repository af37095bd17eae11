"""Tables of a study file that stand for themselves, each with the verbs that act on it."""
