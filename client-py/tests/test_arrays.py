"""Arrays of every type and layout mean what a plain copy of them means, wherever one is taken."""

from __future__ import annotations

import array
import mmap
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_env import make
from test_reset_options import GOAL, TIP
from test_reset_options import needles as needles_of
from test_snapshots import bits
from test_vector import make_vec

import trocar
from trocar import errors

TASK = "NeedleReach-v0"
ENVS = 4

FLOATS = ["f2", "f4", "f8", "longdouble"]
INTEGERS = ["i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"]
NUMBERS = ["?", *INTEGERS, *FLOATS]

Layout = Callable[[NDArray[Any]], Any]
Use = Callable[[Any], Any]


class _Interface:
    """What another library's array may be: it only says how NumPy gets one."""

    def __init__(self, values: NDArray[Any]) -> None:
        self._values = values

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        del copy
        return self._values if dtype is None else self._values.astype(dtype)


def _strided(values: NDArray[Any]) -> NDArray[Any]:
    wide: NDArray[Any] = np.zeros((*values.shape[:-1], 3 * values.shape[-1]), values.dtype)
    wide[..., ::3] = values
    return wide[..., ::3]


def _field(values: NDArray[Any]) -> NDArray[Any]:
    """A column of packed records: no stride is a multiple of the item size."""
    kind = np.dtype([("done", "?"), ("value", values.dtype, values.shape[1:]), ("end", "u2")])
    records = np.zeros(len(values), kind)
    records["value"] = values
    column: NDArray[Any] = records["value"]
    return column


def _misaligned(values: NDArray[Any]) -> NDArray[Any]:
    packet = b"\0" + values.tobytes()
    shifted: NDArray[Any] = np.frombuffer(packet, np.uint8)[1:].view(values.dtype)
    return shifted.reshape(values.shape)


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    constant: NDArray[Any] = values.copy()
    constant.flags.writeable = False
    return constant


LAYOUTS: dict[str, Layout] = {
    "contiguous": lambda values: values.copy(),
    "fortran": np.asfortranarray,
    "strided": _strided,
    "reversed": lambda values: values[::-1].copy()[::-1],
    "mirrored": lambda values: values[..., ::-1].copy()[..., ::-1],
    "transposed": lambda values: values.T.copy().T,
    "field": _field,
    "misaligned": _misaligned,
    "read-only": _read_only,
    "swapped": lambda values: values.astype(values.dtype.newbyteorder()),
    "subclass": lambda values: np.ma.MaskedArray(values),
    "list": lambda values: values.tolist(),
    "tuple": lambda values: tuple(values.tolist()),
    "rows": lambda values: list(values.copy()),
    "interface": _Interface,
}

try:
    import torch  # type: ignore[import-not-found, unused-ignore]
except ImportError:
    pass
else:

    def _torch_transposed(values: NDArray[Any]) -> Any:
        return torch.tensor(values.T.copy()).permute(*reversed(range(values.ndim)))

    LAYOUTS["torch"] = lambda values: torch.tensor(values.copy())
    LAYOUTS["torch, strided"] = lambda values: torch.tensor(values.repeat(2, -1))[..., ::2]
    LAYOUTS["torch, transposed"] = lambda values: _torch_transposed(values)

try:
    import jax  # type: ignore[import-not-found, unused-ignore]
except ImportError:
    pass
else:
    LAYOUTS["jax"] = jax.numpy.asarray


def alike(values: NDArray[Any]) -> Iterator[tuple[str, Any]]:
    """The same values in every layout."""
    for name, layout in LAYOUTS.items():
        if "torch" in name and values.dtype.str[1:] in ("u2", "u4", "u8", "f16"):
            continue  # PyTorch has no such type
        if name == "jax" and values.dtype.itemsize >= 8:
            continue  # JAX makes them narrower
        yield name, layout(values)


def outcome(use: Use, value: Any) -> Any:
    """The bits of what a use of a value gives, or what kind of refusal."""
    try:
        return bits(use(value))
    except trocar.TrocarError as error:
        return type(error), error.field


def drawn(kind: str, shape: tuple[int, ...], scale: float = 1.0) -> NDArray[Any]:
    """Random numbers of that type from -1 to 1, or of what the type has of these."""
    values = np.random.default_rng(3).uniform(-scale, scale, shape)
    dtype = np.dtype(kind)
    if dtype.kind in "iu?b":
        values = np.rint(values / scale * 1.4)
        values = np.abs(values) if dtype.kind in "u?b" else values
    return values.astype(dtype)


class Uses:
    """Every function that takes numbers, with the shape that it takes."""

    def __init__(self, server: str) -> None:
        self.server = server
        self.single = make(TASK, server, reward="dense")
        self.envs = make_vec(TASK, server, ENVS, reward="dense", terminate="success")
        self.pick = make("NeedlePick-v0", server)
        self.picks = make_vec("NeedlePick-v0", server, 2)

    def close(self) -> None:
        for env in (self.single, self.envs, self.pick, self.picks):
            env.close()

    def step(self, value: Any) -> Any:
        self.single.reset(seed=0)
        return self.single.step(value)

    def step_all(self, value: Any) -> Any:
        self.envs.reset(seed=0)
        return self.envs.step(value)

    def send(self, value: Any) -> Any:
        self.envs.reset(seed=0)
        self.envs.send(value, [0, 2, 3])
        return self.envs.recv()

    def goals(self, achieved: Any, desired: Any) -> Any:
        functions = (
            self.envs.compute_reward,
            self.envs.compute_success,
            self.envs.compute_terminated,
            self.envs.compute_truncated,
        )
        return [compute(achieved, desired) for compute in functions]

    def achieved(self, value: Any) -> Any:
        return self.goals(value, np.full((6, 3), 0.25, np.float32))

    def desired(self, value: Any) -> Any:
        return self.goals(np.full((6, 3), 0.25, np.float32), value)

    def states(self, value: Any) -> Any:
        goals = np.full((6, 3), 0.25, np.float32)
        return trocar.features(value, goals, goals, task=self.envs)

    def features_of_goals(self, value: Any) -> Any:
        states = np.full((6, 7), 0.25, np.float32)
        return [
            trocar.features(states, *goals, task=self.envs)
            for goals in ((value, states[:, :3]), (states[:, :3], value))
        ]

    def goal(self, value: Any) -> Any:
        return self.pick.reset(seed=0, options={"goal": value})

    def goals_of_all(self, value: Any) -> Any:
        return self.picks.reset(seed=0, options={"goal": value})

    def tip(self, value: Any) -> Any:
        return self.pick.reset(seed=0, options={"tip": value})

    def needles(self, value: Any) -> Any:
        return self.picks.reset(seed=0, options={"objects": {"needle": value}})


OF_NUMBERS = {
    "step": (5,),
    "step_all": (ENVS, 5),
    "send": (3, 5),
    "achieved": (6, 3),
    "desired": (6, 3),
    "states": (6, 7),
    "features_of_goals": (6, 3),
    "goal": (3,),
    "goals_of_all": (2, 3),
    "tip": (3,),
    "needles": (2, 6),
}


@pytest.fixture
def uses(server: str) -> Iterator[Uses]:
    made = Uses(server)
    yield made
    made.close()


@pytest.mark.parametrize("name", OF_NUMBERS)
def test_numbers(name: str, uses: Uses) -> None:
    use, shape = getattr(uses, name), OF_NUMBERS[name]
    near: dict[str, Any] = {
        "goal": GOAL,
        "goals_of_all": GOAL,
        "tip": TIP[:3],
        "needles": needles_of(uses.server, range(60, 62)),
    }
    for kind in NUMBERS:
        values = drawn(kind, shape)
        if name in near and kind in FLOATS:
            values = (values / 1000 + near[name]).astype(kind)
        plain = values.astype(np.float64 if name in near else np.float32)
        expected = outcome(use, plain)
        for layout, value in alike(values):
            assert outcome(use, value) == expected, (kind, layout)
        is_taken = kind in ("f4", "f8", "longdouble") or name not in near
        assert not (is_taken and isinstance(expected[0], type)), (kind, expected)


def test_rows_that_are_one_row_in_memory(uses: Uses) -> None:
    for kind in ("f4", "f8", "i4", "?"):
        row = drawn(kind, (5,))
        repeated = np.broadcast_to(row, (ENVS, 5))
        assert repeated.strides[0] == 0
        assert outcome(uses.step_all, repeated) == outcome(uses.step_all, repeated.copy())
    goal = np.broadcast_to(np.float32(0.25), (6, 3))
    assert bits(uses.achieved(goal)) == bits(uses.desired(goal))


def test_numbers_are_rounded_once(uses: Uses) -> None:
    ties = [
        np.longdouble(1) + np.longdouble(2) ** -24 + np.longdouble(2) ** -60,
        np.int64(2**60 + 2**36 + 1),
        np.uint64(2**63 + 2**39 + 1),
    ]
    for tie in ties:
        goal = np.zeros(3, tie.dtype)
        goal[0] = tie
        reward = uses.single.compute_reward(goal, np.zeros(3, np.float32), {})
        assert reward == -tie.astype(np.float32)


@pytest.fixture
def envs(server: str) -> Iterator[trocar.TrocarVectorEnv]:
    made = make_vec(TASK, server, ENVS)
    made.reset(seed=0)
    yield made
    made.close()


def test_environment_numbers(envs: trocar.TrocarVectorEnv) -> None:
    snapshot = envs.snapshot()
    one = snapshot[0]
    action = np.full((2, 5), 0.5, np.float32)

    def send(env_ids: Any) -> Any:
        envs.reset(seed=0)
        envs.send(action, env_ids)
        return envs.recv()

    def step_after(use: Callable[[], Any]) -> Any:
        envs.restore(snapshot)
        return use(), envs.step(np.full((ENVS, 5), 0.5, np.float32))

    functions: dict[str, Use] = {
        "send": send,
        "snapshot": lambda ids: envs.snapshot(ids).to_bytes(),
        "restore": lambda ids: step_after(lambda: envs.restore(one, ids)),
        "fork into": lambda ids: step_after(lambda: envs.fork(3, ids)),
        "fork from": lambda ids: step_after(lambda: envs.fork(ids, [0, 1])),
        "states": lambda ids: snapshot[ids].to_bytes(),
        "seeds": lambda ids: envs.reset(seed=list(np.concatenate([ids, ids]))),
    }
    for name, use in functions.items():
        for kind in INTEGERS:
            values = np.array([1, 3]).astype(kind)
            expected = outcome(use, values.astype(np.int64))
            assert not isinstance(expected[0], type)
            for layout, value in alike(values):
                if name == "seeds" and layout == "interface":
                    continue  # it has no elements to concatenate
                assert outcome(use, value) == expected, (name, kind, layout)


def test_a_single_number_of_any_type(envs: trocar.TrocarVectorEnv) -> None:
    snapshot = envs.snapshot()
    first = envs.reset(seed=3)
    forked = envs.fork(2)
    for kind in INTEGERS:
        number: Any = np.array([3, 2]).astype(kind)
        for three, two in (
            (number[0], number[1]),
            (number[:1].reshape(()), number[1:].reshape(())),
        ):
            assert bits(envs.reset(seed=three)) == bits(first)
            assert bits(envs.fork(two)) == bits(forked)
            assert snapshot[two].to_bytes() == snapshot[2].to_bytes()
    assert snapshot[np.int8(-1)].to_bytes() == snapshot[3].to_bytes()
    with pytest.raises(IndexError, match=r"index = .*from -4 to 3"):
        snapshot[np.array([0, 4])]


def test_truth_values(envs: trocar.TrocarVectorEnv) -> None:
    snapshot = envs.snapshot()
    mask = np.array([True, False, False, True])

    def reset(value: Any) -> Any:
        envs.reset(seed=0)
        return envs.reset(options={"reset_mask": value})

    for use in (reset, lambda value: snapshot[value].to_bytes()):
        expected = outcome(use, mask)
        assert not isinstance(expected[0], type)
        for layout, value in alike(mask):
            assert outcome(use, value) == expected, layout
    assert snapshot[mask].to_bytes() == snapshot[[0, 3]].to_bytes()


def test_bytes_of_snapshots(envs: trocar.TrocarVectorEnv) -> None:
    data = envs.snapshot().to_bytes()
    plain = np.frombuffer(data, np.uint8)
    wide = bytearray(2 * len(data))
    wide[::2] = data
    mapped = mmap.mmap(-1, len(data))
    mapped.write(data)
    held: list[Any] = [
        bytearray(data),
        memoryview(data),
        memoryview(wide)[::2],
        memoryview(data[::-1])[::-1],
        memoryview(data).cast("b"),
        memoryview(data).cast("c"),
        array.array("B", data),
        mapped,
        plain.view(np.int8),
        *(value for name, value in alike(plain) if name not in ("list", "tuple", "rows")),
    ]
    for value in held:
        assert trocar.Snapshot.from_bytes(value).to_bytes() == data, type(value)


def refused(use: Use, value: Any, field: str, words: str) -> None:
    with pytest.raises(errors.InvalidRequest) as caught:
        use(value)
    assert field in str(caught.value)
    assert words in str(caught.value), str(caught.value)


WRONG: list[tuple[Any, str]] = [
    (np.zeros((4, 5), complex), "array of shape (4, 5) and type complex128"),
    (np.full((4, 5), "1"), "array of shape (4, 5) and type <U1"),
    (np.full((4, 5), b"1"), "array of shape (4, 5) and type |S1"),
    (np.zeros((4, 5), object), "array of shape (4, 5) and type object"),
    (np.zeros((4, 5), "M8[s]"), "array of shape (4, 5) and type datetime64[s]"),
    (np.zeros(4, [("a", "f4"), ("b", "f4")]), "array of shape (4,) and type [('a'"),
    (np.ma.MaskedArray(np.zeros((4, 5)), np.eye(4, 5, dtype=bool)), "MaskedArray of shape (4, 5)"),
    ([[0.0], [0.0, 1.0]], "[[0.0], [0.0, 1.0]], list"),
    ([None], "[None], list of shape (1,)"),
    ({"a": 1}, "{'a': 1}, dict"),
    ("0.5", "'0.5', str"),
    (None, "None"),
    (object, "<class 'object'>, type"),
]


def test_what_is_no_array_of_numbers_is_refused(uses: Uses, envs: trocar.TrocarVectorEnv) -> None:
    snapshot = envs.snapshot()
    functions: list[tuple[Use, str]] = [
        (uses.step, "action"),
        (uses.step_all, "action"),
        (uses.send, "action"),
        (uses.achieved, "achieved_goal"),
        (uses.desired, "desired_goal"),
        (uses.goal, "options.goal"),
        (uses.goals_of_all, "options.goal"),
        (uses.tip, "options.tip"),
        (uses.needles, "options.objects.needle"),
        (lambda value: envs.send(np.zeros((2, 5)), value), "env_ids"),
        (envs.snapshot, "env_ids"),
        (lambda value: envs.restore(snapshot, value), "env_ids"),
        (envs.fork, "source"),
        (lambda value: envs.reset(seed=value), "seed"),
        (lambda value: envs.reset(options={"reset_mask": value}), "options['reset_mask']"),
        (lambda value: snapshot[value], "index"),
        (trocar.Snapshot.from_bytes, "data"),
    ]
    for use, field in functions:
        for value, words in WRONG:
            optional = field not in ("action", "achieved_goal", "desired_goal", "index", "data")
            if value is None and optional and field != "source":
                continue  # it is left out then
            # A sequence of seeds is read one by one.
            refused(use, value, field, "expected" if field == "seed" else words)
    for use, field in functions[9:13]:
        refused(use, np.array([0.0, 1.0]), field, "array of shape (2,) and type float64")
        refused(use, np.array([True, False]), field, "array of shape (2,) and type bool")
        refused(use, np.array([[0, 1]]), field, "array of shape (1, 2) and type int64")
    refused(functions[14][0], np.ones(4, int), "reset_mask", "array of shape (4,) and type int64")
    refused(functions[15][0], [True, False], "index", "list of shape (2,)")
    refused(functions[15][0], 0.5, "index", "0.5, float")
    refused(functions[16][0], np.zeros(3, "u4"), "data", "array of shape (3,) and type uint32")
    refused(functions[16][0], [1, 2], "data", "[1, 2], list of shape (2,)")


def test_shapes_are_those_of_the_space(uses: Uses) -> None:
    for value in (np.zeros((5, 1), np.float32), np.zeros((5, 1)), [[0.0]] * 5):
        refused(uses.step, value, "action", "shape (5, 1)")
        refused(uses.step, value, "action", "expected shape (5,)")
    refused(uses.step_all, np.zeros(20), "action", "expected shape (4, 5)")
    refused(uses.send, np.zeros((3, 4)), "action", "expected shape (3, 5)")
    refused(uses.achieved, np.zeros((6, 2)), "achieved_goal", "expected shape (..., 3)")
    refused(uses.desired, np.zeros((5, 3)), "desired_goal", "expected shape (6, 3)")
    assert uses.envs.compute_reward(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert uses.envs.compute_reward(np.zeros(3), np.zeros(3)).shape == ()


def test_tensors_that_are_no_arrays_are_refused_with_their_reason(uses: Uses) -> None:
    torch = pytest.importorskip("torch")
    refused(uses.step, torch.zeros(5, requires_grad=True), "action", "detach")
    refused(uses.step, torch.zeros(5, dtype=torch.bfloat16), "action", "type torch.bfloat16")
    refused(uses.goal, torch.zeros(3, requires_grad=True), "options.goal", "detach")


def test_options_take_arrays(server: str) -> None:
    eye = np.array([0.1, 0.2, 0.3])
    options = {"image_size": (20, 30), "camera": "placed", "camera_target": (0.0, 0.0, 0.0)}
    given = {**options, "camera_eye": tuple(eye.tolist())}
    env = trocar.TrocarEnv(TASK, server=server, render_mode="rgb_array", render_options=given)
    env.reset(seed=0)
    expected = env.render()
    env.close()
    for layout, value in alike(eye):
        if layout == "interface":
            continue  # an option may be anything: what is no array by its type is none
        given = {**options, "camera_eye": value}
        env = trocar.TrocarEnv(TASK, server=server, render_mode="rgb_array", render_options=given)
        env.reset(seed=0)
        assert bits(env.render()) == bits(expected), layout
        env.close()
    for value in (np.zeros(3, complex), np.zeros((2, 3)), np.array(["a", 1], object)):
        with pytest.raises(errors.InvalidOption, match="image_size"):
            trocar.TrocarEnv(TASK, server=server, observation="rgb", image_size=value)
