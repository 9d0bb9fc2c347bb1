"""The numbers of contacts in the twin, each with its source.

They were fixed before any policy or expert ran in the twin, but for the last two.
*Manual* is MuJoCo's documentation, https://mujoco.readthedocs.io: the pages XML Reference,
Computation and Modeling.
"""

from __future__ import annotations

TIMESTEP = 1.0 / 2400.0
"""Time step, s: ten of them in one tick of 1/240 s.

Contacts can be as stiff as the time step allows, see :data:`SOLREF`.
"""

GRAVITY = 9.81
"""Acceleration of gravity, m/s²."""

INTEGRATOR = "implicitfast"
"""Manual, on numerical integration: for models with forces that depend on velocities.

The servos of the joints damp.
"""

SOLVER, ITERATIONS, TOLERANCE = "Newton", 100, 1e-10
"""Manual, on algorithms: Newton's method is the most exact of the solvers.

100 iterations are the default. The tolerance is 100 times less than the default, since objects
weigh less than a gram.
"""

CONE = "elliptic"
"""Manual, on ``option/cone``: elliptic cones model reality better.

With a pyramid, friction would depend on the direction of the pull.
"""

IMPRATIO = 100.0
"""Stiffness of friction over that of the normal direction.

Manual, on slip of contacts: a large ratio keeps grasped objects from creeping, where cones are
elliptic. MuJoCo Menagerie has 100 for feet (``unitree_a1/a1.xml``) and 10 for a gripper
(``robotiq_2f85/2f85.xml``). By Coulomb's law, what is held does not creep. A needle that is held by
1 N creeps by 4 µm/s with 100 and by 43 µm/s with 10.
"""

CONDIM = 3
"""Friction along both tangents, none about the normal, none against rolling.

Manual, on ``geom/condim``: torsional friction stands for an area where there is one point. Boxes
touch at the corners of an area, and a wire that lies does at both ends of its pieces.
"""

SOLREF = (2.0 * TIMESTEP, 1.0)
"""Time constant (s) and damping ratio of contacts.

Manual, on parameters of the solver: the time constant should be at least twice the time step, and
a ratio of 1 damps critically. Steel, acetal and silicone sink in by micrometres under 1 N, so
contacts are as stiff as they may be.
"""

SOLIMP = (0.999, 0.999, 0.001, 0.5, 2.0)
"""Impedance d, the same at any depth; the last three numbers then do nothing.

Manual, page Computation: under a force F, a body of mass m sinks in by (1 - d) / d · t² · F / m,
with t as in :data:`SOLREF`. That is 2 µm for the needle of 0.36 g under 1 N. With 0.99, the
greatest of Menagerie's 2F-85, it is 20 µm. Steel on steel sinks in by less than a micrometre.
"""

FINGER_FRICTION = 1.0
"""Coefficient of friction of the jaws, whatever they touch (``server/src/sim/instrument.rs``).

All else has the coefficient of its material in ``assets/materials.csv``. Where two of these meet,
MuJoCo takes the greater. They are 1.0 for all that the scenes have.
"""

FINGER_CONDIM, FINGER_TORSION = 4, 3e-5
"""What fingers touch besides has friction about the normal: at most TORSION · μ · N, N·m.

A finger that is not parallel to a wire touches it at one point, and so does any flat finger the
outside of an arc. Hertz has the area: of a wire of radius 0.5 mm that is bent to 20 mm, on a flat
face, both of steel, under 1 N, the half axes are a = 90 µm and b = 9 µm. The pressure's mean lever
is 3/8 a = 34 µm. Without this, such a grasp is a hinge about the line through both points.

This number came after a policy was tried: README.md has what it did without it.
"""

NOSLIP_ITERATIONS = 10
"""Manual, on slip of contacts: a pass after the solver that takes the creep out of friction.

It was off at first, as by default. By Coulomb's law, a torque below its limit turns nothing. The
solver's rows of friction are soft, as the inverse square of their coefficients. Without the pass, a
needle that was held at one point a finger turned by 0.1 rad/s, under a fifth of the torque that
its contacts bear.
"""
