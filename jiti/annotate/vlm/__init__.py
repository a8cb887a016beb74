"""A vision-language model as an annotator of proposals (supplement, G.1 and G.2), in three stages.

    discover   which ITCs a task has, from its instruction and a few videos   -> a task file for review
    locate     where each ITC of an episode is decided, with evidence         -> proposals without a verdict
    decide     whether it was satisfied there, with rationale and confidence  -> proposals with one

What a stage asks is a `Prompt` (`prompts.py`: words, contact sheets, numbers); a `Backend` answers it (`server.py`,
`inprocess.py`); `answers.py` reads the answer by its JSON schema, and what does not fit never becomes a label.
"""
