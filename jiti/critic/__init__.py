"""The Elegance Critic: frozen features of observations, Q over chunks of actions, Cal-QL, training and evaluation.

features/        observations as vectors, computed once and kept in a memory-mapped cache
dataset chunks   D_elegant as arrays; chunks of actions and their n-step rewards
networks backbone normalize      Q as an ensemble, the actor; a Hugging Face model as Q's trunk
cal_ql           the losses, as pure functions
settings settings_file           every constant with its source; a TOML file of them
train state_file metrics         the loop, what it saves and what it tells
evaluate ranking calibration q_recording   how well a critic ranks, on data that it did not see
"""
