"""`jiti rollout`: a frozen policy plays a task many times, alone and guided by a critic, from the same initial states.

    plan = RolloutPlan(task, "POLICY", "CRITIC", (Guidance("none"), Guidance("jiti", tau=0.1)))
    rollouts = run_rollouts(plan, Path("rollouts/T2"), episodes=50)
    summarize(rollouts), compare_all(rollouts)

`plan` says what to play, `play` plays one episode, `run` many on all cores and resumably; `result` is what is kept of
each, `summary` the numbers, `tau` the threshold. `branch` and `live` show episodes in Rerun, `command` is the command
line's. Importing this package imports none of them.
"""
