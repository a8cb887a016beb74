"""A model in this process, by transformers: the Qwen3-VL family, which Cosmos-Reason2 belongs to, on CPU or GPU.

xgrammar holds it to the schema: at each step, tokens that cannot go on to a fitting answer are ruled out.
"""

import hashlib
import io
import json
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jiti.annotate.vlm.backend import Answer, ModelFailed, Picture, Prompt, Token, Usage
from jiti.errors import UsageError

KEPT_GRAMMARS = 8
"""Compiled schemas that are kept. Our choice: those of one episode's stages."""
TOP = 5
"""Likeliest tokens that are kept at each place."""


class InProcessBackend:
    """One model, one request at a time."""

    concurrency = 1

    def __init__(self, name: str) -> None:
        """`name` is a folder or a Hub id. Raises UsageError when it cannot be loaded or is no such model."""
        import torch
        import transformers

        quiet = transformers.utils.logging
        quiet.disable_progress_bar()
        quiet.set_verbosity_error()
        self.model = _identity(Path(name)) if Path(name).is_dir() else name
        device = "cuda" if torch.cuda.is_available() else "cpu"
        try:
            # No pickles: weights come as safetensors, and no code from the Hub is run.
            self._processor: Any = transformers.AutoProcessor.from_pretrained(name, trust_remote_code=False)
            self._model: Any = transformers.AutoModelForImageTextToText.from_pretrained(
                name, dtype="auto", use_safetensors=True, trust_remote_code=False
            )
        except (OSError, ValueError, KeyError, ImportError) as error:
            raise UsageError(
                f"--vlm-model {name} cannot be loaded: {' '.join(str(error).split())[:300]}. Give a folder with a "
                "model of the Qwen3-VL family, or a Hub id such as nvidia/Cosmos-Reason2-2B."
            ) from error
        self._model = self._model.to(device).eval()
        self._compiler = self._grammars()
        self._compiled: dict[str, Any] = {}
        self._lock = threading.Lock()

    def ask(self, prompt: Prompt) -> Answer:
        """Raises ModelFailed when the memory does not suffice or the model gives no number."""
        import torch

        with self._lock, torch.inference_mode():
            begin = time.perf_counter()
            try:
                text, cut, asked, tokens = self._generate(prompt)
            except (torch.OutOfMemoryError, RuntimeError) as error:
                raise ModelFailed(f"{self.model}: {' '.join(str(error).split())[:300]}") from error
            return Answer(text, cut, Usage(1, asked, len(tokens), time.perf_counter() - begin), tokens)

    def _generate(self, prompt: Prompt) -> tuple[str, bool, int, tuple[Token, ...]]:
        import torch
        from transformers import LogitsProcessorList

        inputs = to_inputs(self._processor, prompt).to(self._model.device)
        torch.manual_seed(prompt.seed)
        sampling = {"do_sample": True, "temperature": prompt.temperature} if prompt.temperature > 0 else {}
        done = self._model.generate(
            **inputs,
            max_new_tokens=prompt.max_tokens,
            logits_processor=LogitsProcessorList([self._held_to(prompt.schema)]),
            output_logits=True,
            return_dict_in_generate=True,
            **({"do_sample": False} | sampling),
        )
        asked = inputs["input_ids"].shape[1]
        ids = done.sequences[0, asked:].tolist()
        stops = self._stops()
        cut = not ids or ids[-1] not in stops
        ids = [i for i in ids if i not in stops]
        tokens = tuple(self._token(i, scores[0]) for i, scores in zip(ids, done.logits, strict=False))
        return self._processor.tokenizer.decode(ids), cut, asked, tokens

    def _grammars(self) -> Any:
        import xgrammar

        tokenizer = self._processor.tokenizer
        size = self._model.config.get_text_config().vocab_size
        stops = sorted(self._stops())
        info = xgrammar.TokenizerInfo.from_huggingface(tokenizer, vocab_size=size, stop_token_ids=stops)
        return xgrammar.GrammarCompiler(info, cache_enabled=False)

    def _held_to(self, schema: Mapping[str, Any]) -> Any:
        """A processor of logits for one answer; the grammar behind it is compiled once."""
        from xgrammar.contrib.hf import LogitsProcessor

        text = json.dumps(schema, sort_keys=False)
        if text not in self._compiled:
            if len(self._compiled) >= KEPT_GRAMMARS:  # every episode has frames, and a schema, of its own
                self._compiled.clear()
            # Without free white space: a model that is not trained for JSON would go on with that for ever.
            self._compiled[text] = self._compiler.compile_json_schema(text, any_whitespace=False, separators=(",", ":"))
        return LogitsProcessor(self._compiled[text])

    def _stops(self) -> set[int]:
        wanted = self._model.generation_config.eos_token_id
        stops = set(wanted if isinstance(wanted, list) else [wanted]) | {self._processor.tokenizer.eos_token_id}
        return {stop for stop in stops if stop is not None}

    def _token(self, number: int, scores: Any) -> Token:
        """The token that was taken and what the model would have said, before the schema and the temperature."""
        logprobs = scores.float().log_softmax(-1)
        values, numbers = logprobs.topk(min(TOP, len(logprobs)))
        decode = self._processor.tokenizer.decode
        others = {decode([n]): v for v, n in zip(values.tolist(), numbers.tolist(), strict=True) if v > -1e30}
        return Token(decode([number]), float(logprobs[number]), others)


def _identity(folder: Path) -> str:
    """The folder's name, and a digest that another model in a folder of that name does not have."""
    files = [path for path in sorted(folder.iterdir()) if path.suffix in (".json", ".safetensors")]
    state = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in files]
    return f"{folder.name}@{hashlib.sha256(repr(state).encode()).hexdigest()[:8]}"


def to_inputs(processor: Any, prompt: Prompt) -> Any:
    """A prompt as a model's processor wants it, in its own chat template."""
    from PIL import Image

    content = [
        {"type": "image", "image": Image.open(io.BytesIO(part.jpeg))}
        if isinstance(part, Picture)
        else {"type": "text", "text": part}
        for part in prompt.parts
    ]
    messages = [
        {"role": "system", "content": [{"type": "text", "text": prompt.system}]},
        {"role": "user", "content": content},
    ]
    return processor.apply_chat_template(
        messages, add_generation_prompt=True, tokenize=True, return_dict=True, return_tensors="pt"
    )
