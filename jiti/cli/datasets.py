"""Commands from labels to a critic: curate, train-critic."""

from pathlib import Path
from typing import Annotated

import typer

from jiti.cli.app import app
from jiti.cli.options import Json, Tasks, Unlabelled, VideoCodec
from jiti.cli.telling import progress_bar, say, until_stopped
from jiti.errors import UsageError


@app.command(short_help="Make a LeRobot dataset of recordings and their labels.")
def curate(
    sources: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SOURCE",
            help="MCAP files, folders of them, LeRobot folders or Hub ids, merged. Default: the current folder.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the dataset.")] = None,
    labels: Annotated[
        list[Path] | None,
        typer.Option("--labels", help="Folder of the labels: one for all sources, or one for each. Default: beside."),
    ] = None,
    tasks: Tasks = None,
    rule: Annotated[
        str, typer.Option("--rule", help="Whose labels count: majority, adjudicated, or one annotator's name.")
    ] = "majority",
    accept: Annotated[
        list[str] | None,
        typer.Option("--accept", help="Count a machine's proposals that no one has settled (sim); may be repeated."),
    ] = None,
    unlabelled: Annotated[
        Unlabelled, typer.Option("--unlabelled", help="Leave episodes without labels out, or keep them.")
    ] = Unlabelled.leave,
    features: Annotated[
        Path | None, typer.Option("--features", help="A TOML file: which stream becomes which feature.")
    ] = None,
    show_features: Annotated[
        bool, typer.Option("--print-features", help="Print the automatic mapping as such a file, and end.")
    ] = False,
    fps: Annotated[
        int | None, typer.Option("--fps", min=1, max=1000, help="Resample to this rate. Default: the recordings' own.")
    ] = None,
    condition: Annotated[
        str | None,
        typer.Option("--filter", help="Keep only these episodes: 'reward == 1', 'success and frames < 400'."),
    ] = None,
    split: Annotated[
        str | None,
        typer.Option(
            "--split",
            help="Shares of train, validation and test, by episode. "
            "Default: the splits that a dataset of jiti has, 0.8,0.1,0.1 for the rest.",
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the splits. Default: 0.")] = None,
    unseen: Annotated[
        list[str] | None,
        typer.Option("--unseen", help="A task (T7) that goes whole into the split `unseen`; may be repeated."),
    ] = None,
    gamma: Annotated[float, typer.Option("--gamma", min=0.0, max=1.0, help="Discount of the return.")] = 0.98,
    codec: Annotated[
        VideoCodec | None,
        typer.Option("--codec", help="Encode videos with it. Default: copy LeRobot's videos, h264 for the rest."),
    ] = None,
    crf: Annotated[
        int | None, typer.Option("--crf", min=0, help="Quality of videos, 0 (best) to 51, or to 63 with av1.")
    ] = None,
    weights: Annotated[
        bool, typer.Option("--weights", help="Write weights of frames too, as lerobot-train takes them (RA-BC).")
    ] = False,
    weights_from: Annotated[
        str | None,
        typer.Option(
            "--weights-from",
            metavar="RUN",
            help="Such weights by the critic of a run of train-critic; without --out, of the dataset SOURCE.",
        ),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write a page about the dataset; without --out, of the dataset SOURCE.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a dataset that is there.")] = False,
    as_json: Json = False,
) -> None:
    """Merge recordings and the labels that count into D_elegant, a LeRobot v3 dataset; a stopped run goes on.

    Example: jiti curate demos --accept sim --out d-elegant --filter 'reward == 1' --report
    """
    from jiti.curate.export import command

    if weights and weights_from:
        raise UsageError("--weights and --weights-from write the same file: pass one of them.")
    request = command.Request(
        sources=tuple(sources or ()),
        out=out,
        labels=tuple(labels or ()),
        tasks=tuple(tasks or ()),
        rule=rule,
        accept=tuple(accept or ()),
        unlabelled=unlabelled.value,
        features=features,
        fps=fps,
        condition=condition,
        split=split,
        seed=seed,
        unseen=tuple(unseen or ()),
        gamma=gamma,
        codec=codec.value if codec else None,
        crf=crf,
        weights=weights,
        report=report,
        overwrite=overwrite,
    )
    if show_features:
        with progress_bar("Opening recordings") as progress:
            shown = command.print_features(request, progress)
        print(shown, end="")
        return
    weigh = None
    if weights_from:
        from jiti.critic.weigh import Weigher

        weigh = Weigher(weights_from)
    with progress_bar("Curating") as progress:
        try:
            done = command.run(request, progress, weigh)
        except KeyboardInterrupt as stop:
            say(" ".join(map(str, ("Stopped.", *stop.args))))  # what is kept, where something was written
            raise
    print(done.to_json() if as_json else done)


@app.command("train-critic", short_help="Train the Elegance Critic on D_elegant.")
def train_critic(
    dataset: Annotated[
        Path | None, typer.Argument(help="A dataset of `jiti curate`. With --evaluate: the run's.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the run; a run there goes on.")] = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", help="TOML file of settings, or `state`: minutes on two cores. Default: the paper's."),
    ] = None,
    features: Annotated[
        str | None, typer.Option("--features", help="state, or smolvla:, groot:, policy: and a folder or Hub id.")
    ] = None,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="Gradient steps.")] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of weights, order and noise.")] = None,
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes that compute features.")] = 1,
    cache: Annotated[
        Path | None, typer.Option("--cache", help="Folder of features. Default: your cache folder.")
    ] = None,
    evaluate: Annotated[
        Path | None, typer.Option("--evaluate", metavar="RUN", help="Say how well the critic of a run does.")
    ] = None,
    split: Annotated[
        str | None, typer.Option("--split", help="Episodes for --evaluate, or all. Default: test.")
    ] = None,
    episodes: Annotated[
        list[int] | None, typer.Option("--episode", help="With --evaluate: one to show in Rerun; may be repeated.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Train the Elegance Critic by Cal-QL, or say how well one does on episodes that it did not see.

    Example: jiti train-critic dataset --out run && jiti train-critic --evaluate run
    """
    from jiti.critic.command import Request, evaluate_request, train_request

    request = Request(
        dataset, out, config, features, steps, seed, workers, cache, evaluate, split, tuple(episodes or ())
    )
    with progress_bar("Evaluating" if evaluate else "Training") as progress:
        work = evaluate_request if evaluate else train_request
        done = until_stopped(lambda: work(request, progress))
    print(done.to_json() if as_json else done)
