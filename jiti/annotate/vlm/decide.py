"""Stage three: whether an ITC was satisfied in a segment, and how sure that is."""

from statistics import fmean

from jiti.annotate.vlm.answers import VERDICTS, Opinion, Span, read_opinion
from jiti.annotate.vlm.ask import Asked, Asker
from jiti.annotate.vlm.facts import GEOMETRIC, fact_table
from jiti.annotate.vlm.notes import Decision
from jiti.annotate.vlm.probability import choice_probability
from jiti.annotate.vlm.prompts import decide_prompt
from jiti.annotate.vlm.sampling import segment_frames
from jiti.annotate.vlm.settings import TEMPERATURE
from jiti.annotate.vlm.sheets import contact_sheets
from jiti.annotate.window import frames_between
from jiti.episodes.episode import Episode
from jiti.tasks.task import ITC


def decide(
    asker: Asker,
    episode: Episode,
    instruction: str,
    itc: ITC,
    span: Span,
    *,
    cameras: tuple[str, ...],
    samples: int,
) -> Decision:
    """The verdict of `samples` answers. Raises ModelFailed when one of them fails, SourceError for bad pictures."""
    start, end = frames_between(episode.clock, span.start_s, span.end_s)
    frames = segment_frames(episode.clock, start, end)
    views = [(camera, contact_sheets(episode, camera, frames)) for camera in cameras]
    facts = fact_table(episode, frames) if itc.criterion in GEOMETRIC else ""
    asked = [
        asker.ask(
            decide_prompt(instruction, itc, span, views, facts, seed=seed, temperature=TEMPERATURE if seed else 0.0),
            read_opinion,
        )
        for seed in range(samples)
    ]
    satisfied, confidence = weigh(asked)
    chosen = next(a.value for a in asked if a.value.satisfied == satisfied)
    votes = sum(a.value.satisfied == satisfied for a in asked)
    said = f"{chosen.rationale} ({votes} of {samples} answers agree; {asker.model})"
    return Decision(satisfied, round(confidence, 4), said, samples=samples, model=asker.model)


def weigh(asked: list[Asked[Opinion]]) -> tuple[bool, float]:
    """The verdict, and the probability that it is right, from votes and from how sure each vote was.

    Each sample counts with the probability that its tokens gave to "satisfied", or with 1 or 0 where the backend gives
    none. The mean over k samples is drawn to 1/2 by one sample that knows nothing, because few samples that agree do
    not make a certainty (rule of succession). Votes decide, an even vote goes to the surer side, and if there is none
    to the first sample, which is the likeliest answer. A verdict is never given with less than 1/2.
    """
    each: list[float] = []
    for one in asked:
        sure = choice_probability(one.answer.tokens, "verdict", VERDICTS)
        each.append(sure[VERDICTS[0]] if sure else float(one.value.satisfied))
    p = (sum(each) + 0.5) / (len(each) + 1)
    if p == 0.5:
        return asked[0].value.satisfied, 0.5
    votes = fmean(float(one.value.satisfied) for one in asked)
    satisfied = votes > 0.5 or (votes == 0.5 and p > 0.5)
    return satisfied, max(0.5, p if satisfied else 1 - p)
