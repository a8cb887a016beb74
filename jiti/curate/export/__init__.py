"""`jiti curate`: recordings and their labels become D_elegant, a LeRobot v3 dataset.

    sources     what is merged, and the labels that count          (counted, verdict values: plan)
    features    which stream becomes which feature                 (automatic, features_file, numbers, scene)
    frames      the dataset's frames in each recording             (segments move with them)
    plan        every episode's place, split and values, before anything is written (planned, agree, split, filter)
    pieces      one episode's rows and videos                      (rows, encode, remux, picture_stats, stats)
    shards      pieces joined into LeRobot's files; journal        (what a stopped run finds again: digest)
    meta        info.json, tasks, episodes, stats, labels, card    (weights beside them)

Pictures are decoded once and encoded once. Memory is that of one episode's numbers and a few pictures, however many
episodes there are.
"""
