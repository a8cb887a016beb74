"""`jiti benchmark` and `jiti demo`: from recordings to the paper's tables, along a plan that is fixed before the run.

`plan` and `plan_file` say what is to be done, `stages` what depends on what, `chain` does what is missing: `make`
recordings, labels and datasets, `training` policies and critics, `playing` tau and rollouts. `cells`, `tables`,
`charts` and `page` read the rollouts and tell them beside `paper`'s figures.
"""
