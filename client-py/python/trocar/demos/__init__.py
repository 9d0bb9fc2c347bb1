"""Demonstrations: episodes of the scripted experts, or of people, as data sets.

``trocar demos`` and ``python -m trocar.demos`` call :func:`record`, which may also let a person
drive. Minari's and LeRobot's formats
need the extra ``trocar[demos]``.

Episode k of a recording is the first episode of the seed ``seed + k``, whatever the number of
environments, so the same recipe gives the same data. Each step is labelled with the stage that the
expert is in, by number in :data:`trocar.STAGES`.
"""

from trocar.demos._episodes import Episode, run
from trocar.demos._record import FORMATS, Recipe, Recording, dataset_path, record

__all__ = ["FORMATS", "Episode", "Recipe", "Recording", "dataset_path", "record", "run"]
