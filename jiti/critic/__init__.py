"""The Elegance Critic: frozen features of observations, Q over chunks of actions, Cal-QL, training and evaluation.

features/                        observations as numbers, computed once, kept in a memory-mapped cache
dataset chunks                   D_elegant as arrays; chunks of actions and their n-step rewards
networks backbone critic         Q as an ensemble and the actor; a Hugging Face model as trunk; both as one thing
cal_ql                           the losses, as pure functions
settings settings_file           every constant with its source; a TOML file of them
step checkpoint resume           one step; saved; what a run may go on with
team metrics                     several processes; what is told
train command                    the loop, and what the command was asked
ranking calibration q_recording evaluate   how a critic does on what it did not see
weigh                            weights of recorded chunks for lerobot-train
"""
