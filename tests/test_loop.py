"""The one training loop: the best weights are kept, what is interrupted goes on, what is lost says so; its optimisers."""

from __future__ import annotations

import copy
import errno
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

import foten.training.loop as training_loop
from foten.training.checkpoint import Checkpoint, Epoch, Progress
from foten.training.config import WindowConfig
from foten.training.loop import Loop, Monitor, Optimiser, run_loop

CONFIG = WindowConfig(epochs=6)


class Counter(nn.Module):
    """A network of one weight, which each step of `counting` makes larger by 1."""

    def __init__(self) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(()))


def value_of(network: nn.Module) -> float:
    return float(network.state_dict()["weight"])


def counting(
    loss_at: Callable[[float], float], n_steps: int = 1, averaging: float = 0.0, train_loss: float = 0.5
) -> Loop:
    """A loop whose validation loss is a function of the weight that it is asked about."""
    network = Counter()

    @torch.no_grad()
    def step(epoch: int, number: int) -> Tensor:
        network.weight += 1
        return torch.tensor(train_loss)

    def validate(of: nn.Module) -> tuple[float, float]:
        loss = loss_at(value_of(of))
        return loss, loss

    return Loop("counter", network, n_steps, step, validate, {}, averaging)


def noisy(name: str, seed: int, averaging: float = 0.9) -> Loop:
    """A small regression whose data each epoch draws, by an optimiser that has a state."""
    torch.manual_seed(seed)
    network = nn.Linear(6, 6)
    optimiser, generator = (
        Optimiser(dict(network.named_parameters()), CONFIG, CONFIG.matrix_learning_rate),
        torch.Generator(),
    )

    def gradients(epoch: int, number: int) -> tuple[Tensor, tuple[Tensor, ...]]:
        if number == 0:
            generator.manual_seed(training_loop.epoch_seed(0, epoch))
        loss = (network(torch.randn(8, 6, generator=generator)) - 1).square().mean()
        return loss.detach(), torch.autograd.grad(loss, list(network.parameters()))

    def validate(of: nn.Module) -> tuple[float, float]:
        with torch.no_grad():
            loss = float((of(torch.eye(6)) - 1).square().mean())
        return loss, loss

    step = training_loop.gradient_step(network, optimiser, gradients, 1.0, training_loop.schedule(CONFIG, 3))
    return Loop(name, network, 3, step, validate, {"optimiser": optimiser}, averaging)


def interrupting(at: int) -> Callable[[Epoch], None]:
    def on_epoch(line: Epoch) -> None:
        if line.epoch == at:
            raise KeyboardInterrupt

    return on_epoch


def test_the_best_epoch_is_kept_and_patience_ends_the_loop() -> None:
    losses = [5.0, 3.0, 2.0, 4.0, 2.0, 4.0, 1.0]
    loop, shown = counting(lambda weight: losses[int(weight)]), list[Epoch]()
    progress = run_loop(loop, replace(CONFIG, patience=3), Monitor(on_epoch=shown.append))
    assert [line.validation_loss for line in progress.epochs] == losses[:6]
    assert shown == progress.epochs
    assert [line.best for line in shown] == [True, True, True, False, False, False]
    assert progress.best.epoch == 2
    assert value_of(loop.network) == 2.0
    assert not loop.network.training


def test_the_averaged_weights_are_validated_and_kept() -> None:
    """By hand: a step leaves min(0.4, n / (n + 9)) of the average; without averaging the last weight of all is nearest to 9."""
    averaged, steps = [0.0], 0.0
    for n in range(1, 13):
        share = min(0.4, n / (n + 9))
        steps = share * steps + (1 - share) * n
        averaged += [steps] * (n % 2 == 0)
    asked = list[float]()

    def loss_at(weight: float) -> float:
        asked.append(weight)
        return abs(weight - 9.0)

    loop = counting(loss_at, 2, 0.4)
    progress = run_loop(loop, CONFIG, Monitor())
    assert asked == pytest.approx(averaged, rel=1e-6)
    best = min(averaged, key=lambda weight: abs(weight - 9.0))
    assert best != averaged[-1]
    assert value_of(loop.network) == pytest.approx(best, rel=1e-6)
    assert progress.best_loss == pytest.approx(abs(best - 9.0), rel=1e-5)


def test_an_interrupted_loop_keeps_its_best_and_says_so() -> None:
    loop = counting(lambda weight: abs(weight - 1))
    progress = run_loop(loop, CONFIG, Monitor(on_epoch=interrupting(3)))
    assert progress.interrupted
    assert [line.epoch for line in progress.epochs] == [0, 1, 2, 3]
    assert value_of(loop.network) == 1.0


def test_an_interrupt_before_anything_was_validated_goes_on_to_the_caller() -> None:
    def interrupted(weight: float) -> float:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_loop(counting(interrupted), CONFIG, Monitor())


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_what_is_not_finite_is_named(wrong: float) -> None:
    with pytest.raises(ValueError, match=r"^the training loss is not finite; is the acceleration full of outliers"):
        run_loop(counting(lambda weight: 1.0, train_loss=wrong), CONFIG, Monitor())
    steps = list[float]()
    with pytest.raises(ValueError, match=r"^the validation loss is not finite; is the acceleration full of outliers"):
        run_loop(counting(lambda weight: steps.append(weight) or wrong), CONFIG, Monitor())  # type: ignore[func-returns-value]
    assert steps == [0.0]  # nothing is trained of it


@pytest.mark.parametrize("stopped_in", [0, 1])
def test_loops_in_one_checkpoint_go_on_as_if_nothing_had_been(stopped_in: int, tmp_path: Path) -> None:
    """Two loops in turn, of which one is interrupted: weights, their average, the optimiser and the log are as without."""
    path, names = tmp_path / "checkpoint.pt", ("first", "second")
    expected, expected_logs = [noisy(name, 3) for name in names], []
    for loop in expected:
        expected_logs.append(run_loop(loop, CONFIG, Monitor()))
    checkpoint = Checkpoint(path, CONFIG)
    for number, name in enumerate(names[: stopped_in + 1]):
        on_epoch = interrupting(4) if number == stopped_in else interrupting(-1)
        run_loop(noisy(name, 3), CONFIG, Monitor(on_epoch=on_epoch, checkpoint=checkpoint))
    resumed = Checkpoint(path, CONFIG, resume=True)
    for name, loop, log in zip(names, expected, expected_logs, strict=True):
        again, shown = noisy(name, 8), list[Epoch]()
        progress = run_loop(again, CONFIG, Monitor(on_epoch=shown.append, checkpoint=resumed))
        for lines in (progress.epochs, shown):
            assert [line.epoch for line in lines] == list(range(7))
        if name == "first" or stopped_in == 1:  # the others begin from weights of their own
            assert [line.validation_loss for line in shown] == [line.validation_loss for line in log.epochs]
            for ours, theirs in zip(again.network.parameters(), loop.network.parameters(), strict=True):
                assert torch.equal(ours, theirs)


def test_a_training_goes_on_from_its_own_checkpoint_alone(tmp_path: Path) -> None:
    """With its seconds, and where the generator of random numbers was; what other code wrote, or half a file, is no beginning."""
    path, about = tmp_path / "a.checkpoint", {"code": "1", "platform": {"kernel": "avx2"}}
    first = Checkpoint.going_on(path, CONFIG, about)
    run_loop(noisy("loop", 3), CONFIG, Monitor(on_epoch=interrupting(4), checkpoint=first))
    expected = torch.rand(3)
    again = Checkpoint.going_on(path, CONFIG, about)
    assert again.elapsed_s() < 1.0  # nothing was taken over yet
    loop = noisy("loop", 8)
    parts = {"network": loop.network, "averaged": noisy("loop", 8).network, **loop.parts}
    assert len(again.load("loop", parts).epochs) == 4
    assert torch.equal(torch.rand(3), expected)
    others = [(CONFIG, {**about, "code": "2"}), (CONFIG, {}), (replace(CONFIG, batch=32), about)]
    for config, of in others:
        with pytest.raises(ValueError, match="written by a run with other settings"):
            Checkpoint(path, config, resume=True, about=of)
        assert Checkpoint.going_on(path, config, of).load("loop", {}).epochs == []
    torch.save(torch.ones(2), tmp_path / "tensor")
    for damaged in (path.read_bytes()[:500], b"a text", (tmp_path / "tensor").read_bytes()):
        path.write_bytes(damaged)
        assert Checkpoint.going_on(path, CONFIG, about).load("loop", {}).epochs == []


def test_seconds_before_a_stop_count_and_what_is_done_twice_counts_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten seconds before a loop of two epochs of a second each, the second of which is stopped; then the same again."""
    now, path, config = [0.0], tmp_path / "a.checkpoint", replace(CONFIG, epochs=2)
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])

    def trained(epoch_s: dict[int, float], stop: int) -> Checkpoint:
        checkpoint = Checkpoint.going_on(path, config, {})
        now[0] += 10.0

        def on_epoch(line: Epoch) -> None:
            now[0] += epoch_s.get(line.epoch, 0.0)
            interrupting(stop)(line)

        run_loop(noisy("loop", 3), config, Monitor(on_epoch=on_epoch, checkpoint=checkpoint))
        return checkpoint

    trained({1: 1.0, 2: 1.0}, stop=2)
    now[0] = 100.0
    assert trained({2: 1.0}, stop=-1).elapsed_s() == pytest.approx(12.0)


def full_disk(path: Path, *_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device", str(path))


@pytest.mark.parametrize("full_from", [0, 2])
def test_a_full_disk_costs_the_checkpoint_and_not_the_training(
    full_from: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A note in one line, however many checkpoints could not be written; the one before stays."""
    path, loop = tmp_path / "checkpoint.pt", counting(lambda weight: -weight)

    def on_epoch(line: Epoch) -> None:
        if line.epoch == full_from:
            monkeypatch.setattr(Path, "write_bytes", full_disk)

    progress = run_loop(loop, CONFIG, Monitor(on_epoch=on_epoch, checkpoint=Checkpoint(path, CONFIG)))
    assert value_of(loop.network) == 6.0
    assert progress.notes == [f"{path}: no space left on device; the training went on without its checkpoint"]
    if not full_from:
        assert not list(tmp_path.iterdir())
        return
    saved = torch.load(path, weights_only=True)["loops"]["counter"]
    assert [line["epoch"] for line in saved["epochs"]] == [0, 1]


def test_a_checkpoint_that_is_another_runs_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    torch.save({"config": vars(CONFIG), "network": {}}, path)
    with pytest.raises(ValueError, match=r"checkpoint\.pt is of another version of foten"):
        Checkpoint(path, CONFIG, resume=True)
    run_loop(counting(lambda weight: -weight), CONFIG, Monitor(checkpoint=Checkpoint(path, CONFIG)))
    averaged = counting(lambda weight: -weight, averaging=0.5)
    with pytest.raises(ValueError, match=r"checkpoint\.pt is of another version of foten"):
        run_loop(averaged, CONFIG, Monitor(checkpoint=Checkpoint(path, CONFIG, resume=True)))
    with pytest.raises(ValueError, match=r"checkpoint\.pt was written by a run with other settings"):
        Checkpoint(path, replace(CONFIG, batch=32), resume=True)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(ValueError, match=r"checkpoint\.pt is damaged"):
        Checkpoint(path, CONFIG, resume=True)


def progress_of(errors: list[float]) -> Progress:
    """What has been after some epochs, from epoch 0 on, by their validation errors."""
    best = min(range(len(errors)), key=errors.__getitem__)
    lines = [Epoch(n, 1.0, error, error, 0.1, n in (0, best)) for n, error in enumerate(errors)]
    return Progress(lines, best_loss=errors[best])


@pytest.mark.parametrize(
    ("errors", "on", "noted"),
    [
        ([1.0], True, False),
        ([1.0, 0.9999, 0.9998], True, False),
        ([1.0, 0.9999, 0.9998, 0.9995], False, True),  # the trial ends without a gain of 0.1 %
        ([1.0, 1.0, 0.9985, 1.0], True, False),
        ([1.0, 0.9, 0.91, 0.92, 0.93], True, False),
        ([1.0, 0.9, 0.91, 0.92, 0.93, 0.94], False, False),  # patience of 4
    ],
)
def test_trial_and_patience_end_a_training(errors: list[float], on: bool, noted: bool) -> None:
    progress = progress_of(errors)
    assert training_loop.should_continue(progress, 4, (3, 1e-3)) == on
    note = "the network gains 0.05 % on the validation blocks in 3 epochs, less than 0.1 %: its training stops there"
    assert progress.notes == [note] * noted


def test_what_a_later_loop_says_is_taken_over_once() -> None:
    progress = Progress(notes=["full"])
    progress.include(Progress(notes=["full"]))
    assert (progress.interrupted, progress.notes) == (False, ["full"])
    progress.include(Progress(interrupted=True, notes=["slow"]))
    progress.include(Progress())
    assert (progress.interrupted, progress.notes) == (True, ["full", "slow"])


def test_a_step_clips_all_gradients_at_once_and_follows_the_schedule() -> None:
    """A gradient of norm 5 over two parameters, held to 2; what is smaller is left."""
    network = nn.Linear(1, 1)
    seen = list[tuple[float, float, float]]()

    class Recorded:
        def step(self, rate: float) -> None:
            seen.append((float(network.weight.grad), float(network.bias.grad), rate))  # type: ignore[arg-type]

    for clip_norm in (2.0, 9.0, 0.0):
        step = training_loop.gradient_step(
            network,
            Recorded(),  # type: ignore[arg-type]
            lambda epoch, number: (torch.tensor(7.0), [torch.tensor([[3.0]]), torch.tensor([4.0])]),
            clip_norm,
            lambda epoch, number: epoch + 0.1 * number,
        )
        assert step(2, 3) == 7.0
    assert seen[0] == pytest.approx((1.2, 1.6, 2.3), rel=1e-5)
    assert seen[1:] == [(3.0, 4.0, 2.3)] * 2


def test_shares_are_added_in_their_order_whichever_thread_is_first() -> None:
    """1, 1e8 and −1e8 in float32: in this order their sum is 0, in every other of two threads 1."""
    network = nn.Linear(1, 1, bias=False)
    factors, later = (1.0, 1e8, -1e8), [threading.Event() for _ in range(4)]
    later[-1].set()

    def loss_of_share(k: int) -> Tensor:
        assert later[k + 1].wait(5)  # the last share is computed first
        later[k].set()
        return factors[k] * network.weight.sum()

    with ThreadPoolExecutor(3) as pool:
        loss, (gradient,) = training_loop.shared_gradients(list(network.parameters()), pool, loss_of_share, 3)
    assert float(gradient) == 0.0
    assert abs(float(loss)) < 10


def test_the_rate_rises_over_a_tenth_and_falls_by_half_a_cosine() -> None:
    config = WindowConfig(epochs=5)
    rate = training_loop.schedule(config, 4)
    rates = [rate(epoch, number) for epoch in range(1, 6) for number in range(4)]
    fall = [0.5 * (1 + math.cos(math.pi * n / 18)) for n in range(18)]
    assert rates == pytest.approx([0.5, 1.0, *fall])
    assert {training_loop.schedule(replace(config, schedule="constant"), 4)(epoch, 0) for epoch in range(1, 6)} == {1.0}


def parameters(seed: int = 0) -> dict[str, nn.Parameter]:
    torch.manual_seed(seed)
    shapes = {"square": (12, 12), "tall": (24, 8), "narrow": (16, training_loop.MIN_SIDE), "bias": (12,)}
    return {name: nn.Parameter(torch.randn(*shape)) for name, shape in shapes.items()}


@pytest.mark.parametrize("shape", [(16, 16), (40, 9), (7, 30), (3, 16, 12)])
def test_singular_values_come_near_one_and_directions_stay(shape: tuple[int, ...]) -> None:
    """Oracle: the orthogonal factor U Vᵀ of NumPy's singular value decomposition."""
    matrices = torch.from_numpy(np.random.default_rng(0).standard_normal(shape)).float()
    found = training_loop.orthogonalised([matrices, matrices.mT])[0].double().numpy()
    u, _, vt = np.linalg.svd(matrices.double().numpy(), full_matrices=False)
    # The quintic ends between 0.68 and 1.14, whatever a singular value was, down to 1 % of their norm.
    assert np.linalg.svd(found, compute_uv=False) == pytest.approx(0.93, abs=0.27)
    overlap = np.sum(found * (u @ vt), axis=(-2, -1)) / u.shape[-1]
    assert (overlap > 0.68).all()


def test_a_matrix_without_a_gradient_decays() -> None:
    of = parameters()
    before = of["square"].detach().clone()
    for parameter in of.values():
        parameter.grad = torch.zeros_like(parameter)
    Optimiser(of, WindowConfig(learning_rate=0.1, weight_decay=0.5), 3e-3).step(0.5)
    torch.testing.assert_close(of["square"].detach(), 0.975 * before)


def test_steps_without_matrices_are_those_of_pytorchs_adamw() -> None:
    """Oracle: torch.optim.AdamW, at a rate that changes, with decay; and a state that goes on where it was."""
    config = WindowConfig(weight_decay=0.2)
    of, expected = parameters(), parameters()
    ours, theirs = Optimiser(of, config), torch.optim.AdamW(expected.values(), weight_decay=0.2)
    for number in range(30):
        rate = 1 - number / 40
        theirs.param_groups[0]["lr"] = rate * config.learning_rate
        for name, parameter in of.items():
            parameter.grad = torch.randn_like(parameter) * (parameter.detach() - 1)
            expected[name].grad = parameter.grad.clone()
        if number == 15:
            state, ours = copy.deepcopy(ours.state_dict()), Optimiser(of, config)
            ours.load_state_dict(state)
        ours.step(rate)
        theirs.step()
    for name, parameter in of.items():
        torch.testing.assert_close(parameter, expected[name], rtol=1e-5, atol=1e-7)  # float32


def test_no_compiler_is_loaded_for_an_optimiser() -> None:
    """It takes longer than an epoch."""
    code = (
        "import sys, torch; from foten.training.config import WindowConfig; from foten.training.loop import Optimiser; "
        "p = torch.nn.Parameter(torch.zeros(3)); o = Optimiser({'p': p}, WindowConfig()); p.grad = torch.ones(3); o.step(1.0); "
        "print([name for name in ('torch._dynamo', 'sympy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("kind", ["muon", "adamw"])
def test_matrices_move_alike_in_every_direction_and_the_rest_by_adam(kind: str) -> None:
    """A gradient with singular values a hundredfold apart moves a matrix about as far along each; AdamW alone has none."""
    of, config = parameters(), WindowConfig(weight_decay=0.0)
    before = {name: parameter.detach().clone() for name, parameter in of.items()}
    optimiser = Optimiser(of, config, config.matrix_learning_rate if kind == "muon" else 0.0)
    u, _, v = torch.linalg.svd(torch.randn(12, 12))
    for parameter in of.values():
        parameter.grad = torch.ones_like(parameter)
    if kind == "muon":
        of["square"].grad = u @ torch.diag(torch.logspace(0, -2, 12)) @ v
    optimiser.step(1.0)
    if kind == "muon":
        moved = torch.linalg.svdvals((before["square"] - of["square"]).detach() / config.matrix_learning_rate)
        assert float(moved.max() / moved.min()) < 4
    for name in ("narrow", "bias", *(["square"] if kind == "adamw" else [])):
        step = (before[name] - of[name]).detach() / config.learning_rate
        torch.testing.assert_close(step, torch.ones_like(step), rtol=1e-3, atol=0)  # its first, whatever the gradient
