"""Room `pipeline`: the only place that knows the order of the walk.

May be changed here: the study file's vocabulary (`study.py`), the order of the stages and what each passes on.
"""
