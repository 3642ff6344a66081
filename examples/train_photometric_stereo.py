"""Train a network for photometric stereo, like the one that ships with the package, on synthetic pixels.

Most of the pixels are taken from rendered scenes, whose parts cast shadows and reflect light on each other; the others
have random walls beside them.

    python examples/train_photometric_stereo.py                          # on a laptop, or on one GPU where there is one
    torchrun --nproc-per-node 2 examples/train_photometric_stereo.py     # on several processes or machines

The weights that ship were trained by four processes on one GPU:

    torchrun --nproc-per-node 4 examples/train_photometric_stereo.py --steps 8000 --observations 32768 \
        --workers 2 --threads 1

Every step draws its samples by index, so that any number of processes sees the same batch; gradients are averaged.
When killed, training resumes from the last checkpoint and ends with the same weights, by itself with
`torchrun --max-restarts 3`. Writes network.pt (half precision, weights averaged over steps), checkpoint.pt and
curve.csv.
"""

from __future__ import annotations

import argparse
import csv
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor
from torch.utils.data import DataLoader

import torch_orennayar as ton

RATE, LAST_RATE = 2e-3, 0.01
"""Largest learning rate, and the last one as a share of it. Set by hand, as all of these."""
WARM_UP = 100
"""Steps in which the learning rate rises."""
DECAY = 1e-3
"""Weight decay."""
AVERAGE = 0.995
"""Decay per step of the moving average of the weights."""
CLIP = 1.0
"""Largest norm of the gradient of a step."""
FORECAST_WEIGHT = 0.1
"""Weight in the loss of the network's forecast of its own error."""


class Training:
    """The network, its moving average and the optimiser: the state of training, which checkpoints hold."""

    def __init__(self, options: argparse.Namespace) -> None:
        torch.manual_seed(options.seed)
        self.options, self.step = options, 0
        self.device = torch.device(options.device)
        self.network = ton.SetNetwork().to(self.device)
        self.average = ton.SetNetwork().to(self.device)
        self.average.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(self.network.parameters(), lr=RATE, betas=(0.9, 0.98), weight_decay=DECAY)
        self.rate = torch.optim.lr_scheduler.LambdaLR(self.optimiser, self._rate)

    def _rate(self, step: int) -> float:
        """A linear warm-up, then half a cosine down to `LAST_RATE`."""
        if step < WARM_UP:
            return (step + 1) / WARM_UP
        share = torch.tensor((step - WARM_UP) / max(1, self.options.steps - WARM_UP))
        return float(LAST_RATE + (1 - LAST_RATE) / 2 * (1 + torch.cos(torch.pi * share.clamp_max(1))))

    def run_step(self, samples: Iterator[ton.SyntheticPixels], share: int, world: int) -> Tensor:
        """One step on this process's ``share`` of the samples; mean loss and degrees over all processes, (2,)."""
        groups = self.options.groups
        for parameter in self.network.parameters():
            parameter.grad = torch.zeros_like(parameter)  # where a process has no share of a step
        sums = torch.zeros(2, device=self.device)
        for _ in range(share):
            sample = next(samples)
            observed, lights, normal = (
                t.to(self.device) for t in (sample["observed"], sample["lights"], sample["normal"])
            )
            loss, degrees = losses(self.network, observed, lights, normal)
            (loss / groups).backward()
            sums += torch.stack((loss.detach(), degrees)) / groups
        if world > 1:
            sums = self._sum_over_processes(sums)
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), CLIP)
        self.optimiser.step()
        self.rate.step()
        self.step += 1
        with torch.no_grad():
            keep = min(AVERAGE, self.step / (self.step + 10))
            for mean, value in zip(self.average.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(value, 1 - keep)
        return sums

    def _sum_over_processes(self, sums: Tensor) -> Tensor:
        """Sum the gradients and ``sums`` over all processes, in one message."""
        gradients = [p.grad for p in self.network.parameters() if p.grad is not None]  # all of them, see run_step
        flat = torch.cat([sums, *(g.flatten() for g in gradients)])
        dist.all_reduce(flat)
        place = len(sums)
        for gradient in gradients:
            gradient.copy_(flat[place : place + gradient.numel()].reshape(gradient.shape))
            place += gradient.numel()
        return flat[: len(sums)].clone()

    def state(self) -> dict[str, Any]:
        """The checkpoint."""
        return {
            "step": self.step,
            "task": task(self.options),
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "rate": self.rate.state_dict(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Resume from a checkpoint."""
        self.step = state["step"]
        for part in ("network", "average", "optimiser", "rate"):
            getattr(self, part).load_state_dict(state[part])


def losses(network: ton.SetNetwork, observed: Tensor, lights: Tensor, normal: Tensor) -> tuple[Tensor, Tensor]:
    """The loss and the mean error of the normals in degrees.

    The loss is the mean length of the normals' error plus the negative log-likelihood of the forecast of that length,
    by Laplace's distribution.
    """
    tokens = ton.make_tokens(observed, lights)
    with torch.autocast(tokens.values.device.type, torch.bfloat16, enabled=tokens.values.is_cuda):
        found, forecast = network.read(tokens)
    error = (found.float() - normal).square().sum(1).add(1e-12).sqrt()
    scale = forecast.float()[:, 0]
    surprise = (error.detach() / scale + scale.log()).mean()
    degrees = torch.rad2deg(2 * (error.detach() / 2).clamp_max(1).asin()).mean()
    return error.mean() + FORECAST_WEIGHT * surprise, degrees


def task(options: argparse.Namespace) -> dict[str, int]:
    """The options that must be the same to resume from a checkpoint."""
    return {name: getattr(options, name) for name in ("steps", "groups", "observations", "scenes", "seed")}


def write_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Write a file under another name and rename it, so that it is never torn by a kill."""
    temporary = file.with_name(f"{file.name}.part")
    write(temporary)
    temporary.replace(file)


def save(folder: Path, training: Training) -> None:
    """Write the checkpoint; the one before stays as previous.pt."""
    current = folder / "checkpoint.pt"
    if current.exists():
        current.replace(folder / "previous.pt")
    write_whole(current, lambda file: torch.save(training.state(), file))


def resume(folder: Path, training: Training) -> None:
    """Load the newest checkpoint that can be read, if there is one.

    Raises:
        FileError: there are checkpoints, but none can be read, or they belong to another task.
    """
    broken = []
    for name in ("checkpoint.pt", "previous.pt"):
        file = folder / name
        if not file.exists():
            continue
        try:
            state = torch.load(file, map_location=training.device, weights_only=True)
            same = state["task"] == task(training.options)
            if same:
                training.load(state)
        except Exception as error:  # a torn file raises errors of many kinds
            print(f"{file} cannot be read ({type(error).__name__}): trying the one before", flush=True)
            broken.append(f"{file}: {type(error).__name__}: {error}")
            continue
        if not same:
            raise ton.FileError(
                str(file), expected=str(task(training.options)), got=str(state["task"]), mend="use another --output"
            )
        print(f"going on from step {training.step}", flush=True)
        return
    if broken:
        raise ton.FileError(str(folder), expected="a checkpoint", got="; ".join(broken), mend="use another --output")


def processes_here() -> int:
    """Processes that torchrun started on this machine."""
    return int(os.environ.get("LOCAL_WORLD_SIZE", "1"))


def meeting_place() -> Any:
    """Where the processes find each other; torchrun keeps its own, with old addresses, when it starts them again."""
    kept = os.environ.get("TORCHELASTIC_USE_AGENT_STORE") == "True"
    master = not kept and os.environ["RANK"] == "0"
    place = os.environ["MASTER_ADDR"], int(os.environ["MASTER_PORT"])
    store = dist.TCPStore(*place, is_master=master)  # type: ignore[attr-defined]
    start = os.environ.get("TORCHELASTIC_RESTART_COUNT", "0")
    return dist.PrefixStore(f"start {start}", store)  # type: ignore[attr-defined]


@contextmanager
def processes(device: str) -> Iterator[tuple[int, int]]:
    """Rank and number of processes; a process group where torchrun started them, also of several to a GPU."""
    if "RANK" not in os.environ:
        yield 0, 1
        return
    gpu_each = device == "cuda" and processes_here() <= torch.cuda.device_count()
    rank, world = int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])
    dist.init_process_group("nccl" if gpu_each else "gloo", store=meeting_place(), rank=rank, world_size=world)
    try:
        yield dist.get_rank(), dist.get_world_size()
    finally:
        dist.destroy_process_group()


def train(options: argparse.Namespace) -> Training:
    """Train from the start or from the last checkpoint."""
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    with processes(options.device) as (rank, world):
        if options.device == "cuda":
            torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
        training = Training(options)
        resume(folder, training)
        source = ton.SyntheticCaptures(
            "pixels",
            seed=options.seed,
            start=training.step * options.groups,
            observations=options.observations,
            scenes=options.scenes,
        )
        if options.workers and training.step < options.steps:
            source.render_scenes(options.workers)
        samples = iter(DataLoader(source, batch_size=None, num_workers=options.workers))
        begin = source.start + rank  # the data source deals its samples out one by one
        begun, spent = time.perf_counter(), time.process_time()
        kept = [row for row in read_curve(folder / "curve.csv") if int(row[0]) <= training.step]
        means: list[Tensor] = []
        while training.step < options.steps:
            first = training.step * options.groups
            share = len(range(first + (begin - first) % world, first + options.groups, world))
            means.append(training.run_step(samples, share, world))
            if training.step % options.every and training.step < options.steps:
                continue
            loss, degrees = torch.stack(means).double().mean(0).tolist()
            means = []
            if rank == 0:
                seconds = time.perf_counter() - begun
                kept.append([str(training.step), f"{loss:.6f}", f"{degrees:.3f}", f"{seconds:.1f}"])
                write_curve(folder / "curve.csv", kept)
                save(folder, training)
                print(f"step {training.step} of {options.steps}: loss {loss:.4f}, {degrees:.2f} degrees", flush=True)
        if rank == 0:
            ton.save_network(folder / "network.pt", training.average)
            spent = time.process_time() - spent
            print(f"{training.step} steps, {spent:.0f} CPU seconds of this process; {folder / 'network.pt'}")
    return training


def read_curve(file: Path) -> list[list[str]]:
    """Rows of the curve without its header."""
    if not file.is_file():
        return []
    with file.open(newline="") as stream:
        return list(csv.reader(stream))[1:]


def write_curve(file: Path, rows: list[list[str]]) -> None:
    """Step, mean loss, mean error in degrees and seconds since the start of this process."""

    def write(path: Path) -> None:
        with path.open("w", newline="") as stream:
            csv.writer(stream).writerows([["step", "loss", "degrees", "seconds"], *rows])

    write_whole(file, write)


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=5500)
    parser.add_argument("--groups", type=int, default=8, help="samples of a step, shared by all processes")
    parser.add_argument("--observations", type=int, default=1536, help="pixels times lights of a sample")
    parser.add_argument("--scenes", type=int, default=400, help="rendered scenes that most samples are taken from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=100, help="steps between checkpoints")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--workers", type=int, help="processes that make samples; default: 0, with a GPU one per core")
    parser.add_argument("--threads", type=int, default=0, help="of each process; default: torch's choice")
    parser.add_argument("-o", "--output", type=Path, default=Path("out/train"))
    options = parser.parse_args(arguments)
    if options.threads:
        torch.set_num_threads(options.threads)
    if options.workers is None:
        cores = (os.cpu_count() or 1) // processes_here()
        options.workers = max(1, cores - 1) if options.device == "cuda" else 0
    return options


if __name__ == "__main__":
    try:
        train(parse())
    except ton.TorchOrenNayarError as mistake:
        raise SystemExit(f"error: {mistake}") from None
