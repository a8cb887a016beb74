"""An evaluation that a person judges: guidances in an order that is not told, verdicts by one key each, ESR with
intervals. It may take days: what was played and judged is kept, and the same command goes on there."""
