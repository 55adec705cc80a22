"""The craft of ``[attitude.vessel]`` at sea: the estimator's equations of motion handed to the simulator.

The simulator knows nothing of the estimator, and a second copy of the equations would have to be kept in step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from heaved.estimation.craft.dynamics import Craft, Vessel
from heaved.simulate.hydrofoil import Hull, Passage, Voyage, sail

if TYPE_CHECKING:
    from collections.abc import Sequence


def hull(vessel: Vessel) -> Hull:
    """What the waves get hold of."""
    foils = (vessel.fore_foil, vessel.aft_foil)
    return Hull(
        heave_force_ps2=vessel.heave_stiffness_npm / vessel.mass_kg,
        pitch_force_ps2=vessel.pitch_stiffness_nmprad / vessel.pitch_inertia_kgm2,
        foil_arms_m=(foils[0].arm_m, foils[1].arm_m),
        foil_depths_m=(foils[0].depth_m, foils[1].depth_m),
    )


def voyages(vessel: Vessel, seeds: Sequence[int], passage: Passage) -> list[Voyage]:
    """One voyage per seed, heave from the trim at the speed of the passage.

    Raises:
        ArithmeticError: the vessel comes to no rest at that speed.
    """
    craft = Craft(vessel)
    trim = craft.trim(passage.speed_mps)
    return [
        msgspec.structs.replace(made, heave_m=made.heave_m - trim[0], measured_heave_m=made.measured_heave_m - trim[0])
        for made in sail(craft.accelerations, trim, seeds, passage, hull(vessel))
    ]
