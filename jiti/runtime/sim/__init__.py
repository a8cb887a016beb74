"""MuJoCo: tasks, scripted demonstrations and their recordings, with pictures where the machine has a GL library."""
