"""What every extractor must do: give a frame the same features in whatever batch it comes."""

import torch  # noqa: TID253  imported by tests of extractors only


def rows(batch, which):
    return {k: [v[i] for i in which] if isinstance(v, list) else v[which] for k, v in batch.items()}


def same_in_any_batch(extractor, batch):
    whole = extractor.features(batch)
    frames = len(batch["task"])
    assert whole.shape == (frames, extractor.tokens, extractor.size)
    assert not whole.requires_grad
    alone = torch.cat([extractor.features(rows(batch, [i])) for i in range(frames)])
    assert torch.allclose(whole, alone, atol=1e-5)
    turned = extractor.features(rows(batch, [2, 0, 1]))
    assert torch.allclose(turned, whole[[2, 0, 1]], atol=1e-5)
    return whole
