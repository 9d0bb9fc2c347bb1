"""What a soft body costs: Trocar's, rapier's and MuJoCo's, the same slab on one core, in turns.

`make bench-soft` builds what this needs and runs it. The slab has 48 x 48 x 6 mm of 5 kPa, with a
Poisson's ratio of 0.45, in cells of 3 mm: 17 x 17 x 3 nodes. It hangs from one edge.

* ``Trocar``, ``rapier``: the benchmark ``server/benches/soft.rs``, a step of 1/240 s;
* ``MuJoCo``: a flex of full degrees of freedom with the integrator ``discrete`` and steps of 4 ms,
  the only one of those tried that is stable at this length.

Times are for a millisecond of the slab's life, on one core that should be idle.
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import time

import mujoco

STEP = 1 / 240
"""Of the benchmark in Rust, s."""

MUJOCO_STEP = 4e-3
"""Of MuJoCo, s."""

UNITS = {"ns": 1e-9, "µs": 1e-6, "us": 1e-6, "ms": 1e-3, "s": 1.0}
"""In which criterion tells times, s."""

MODEL = f"""
<mujoco>
  <option timestep="{MUJOCO_STEP}" gravity="0 0 -9.81"
          integrator="discrete" solver="CG" tolerance="1e-6"/>
  <size memory="500M"/>
  <worldbody>
    <flexcomp name="slab" type="grid" dim="3" count="17 17 3" spacing="0.003 0.003 0.003"
              mass="{1000 * 0.048 * 0.048 * 0.006}" radius="0.0005" dof="full">
      <edge damping="0"/>
      <elasticity young="5e3" poisson="0.45" damping="0.01"/>
      <contact selfcollide="none" conaffinity="0" contype="0"/>
      <pin gridrange="0 0 0 0 16 2"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""


def in_rust(bench: str) -> dict[str, float]:
    """Seconds for a second of the slabs in the benchmark."""
    command = [bench, "--bench", "--noplot", "--warm-up-time", "1", "--measurement-time", "3"]
    output = subprocess.run(
        [*command, "soft/hanging"], check=True, capture_output=True, text=True
    ).stdout
    found = {}
    for name, number, unit in re.findall(
        r"soft/(hanging[a-z ]*?)\s+time:\s+\[\S+ \S+ (\S+) (\S+)", output
    ):
        found[name] = float(number) * UNITS[unit] / STEP
    return {"Trocar": found["hanging"], "rapier": found["hanging in rapier"]}


def in_mujoco(steps: int) -> float:
    """The same of MuJoCo."""
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    start = time.perf_counter()
    for _ in range(steps):
        mujoco.mj_step(model, data)
    return (time.perf_counter() - start) / (steps * MUJOCO_STEP)


def main() -> int:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bench", help="the program that `cargo bench --bench soft` builds")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=50, help="of MuJoCo in a round")
    given = parser.parse_args()
    rounds = []
    for number in range(given.rounds):
        rounds.append({**in_rust(given.bench), "MuJoCo": in_mujoco(given.steps)})
        print(f"round {number + 1} of {given.rounds}", file=sys.stderr)
    print(f"| engine | time for 1 ms, µs | times Trocar's (median of {given.rounds} rounds) |")
    print("|---|---|---|")
    for engine in rounds[0]:
        time_of = statistics.median(one[engine] for one in rounds) * 1e3
        ratio = statistics.median(one[engine] / one["Trocar"] for one in rounds)
        print(f"| {engine} | {time_of:,.0f} | {ratio:.1f} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
