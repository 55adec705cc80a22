"""The room of the stages that live beside the heave: the hull's deformation, the attitude of a craft, a moving crane,
an existing MRU that ours is compared with.

All are off unless configured. They are given copies of what the pipeline is given and nothing of theirs goes back, so
whatever befalls them the heave is the same to the bit. An exception in one of them, which is a bug, is caught here and
nowhere else: it is counted as a reset, and the stage starts anew.
"""

from __future__ import annotations

from collections import Counter
from contextlib import contextmanager
from typing import TYPE_CHECKING

from heaved.estimation.craft import fusion
from heaved.estimation.craft.stage import AttitudeStage
from heaved.estimation.crane import geometry
from heaved.estimation.crane.estimator import CraneEstimator, Place, Worth
from heaved.estimation.hull import estimate as hull
from heaved.estimation.hull.stage import UNKNOWN, HullStage
from heaved.estimation.reference_mru import estimator as reference_mru
from heaved.estimation.reference_mru.estimator import ReferenceMru
from heaved.samples import (
    CraftMotion,
    CraftSample,
    CraneSample,
    Fault,
    HeaveState,
    HullAngles,
    ImuSample,
    MotionFrame,
    MruComparison,
    MruSample,
    RatesSample,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from heaved.estimation.hull.refit import RefitJob, RefitResult
    from heaved.estimation.hull.remembered import SavedHull
    from heaved.estimation.lever_arm import Crane, Vector

NO_CRANE = Worth(HeaveState.INVALID, ("no [crane] is configured",))
FAILED = Worth(HeaveState.INVALID, ("the estimator of the crane failed: see the log",))


class Stages:
    """The stages that are switched on, and what befell them.

    Attributes:
        failure: the last exception of a stage, for the log; None when there was none since it was looked at.
    """

    def __init__(
        self,
        hull_params: hull.Params | None = None,
        attitude_params: fusion.Params | None = None,
        crane_params: geometry.Params | None = None,
        reference_mru_params: reference_mru.Params | None = None,
        *,
        refit_inline: bool = True,
    ) -> None:
        """``refit_inline``: the hull's flexure is fitted where it is due, which takes some tenths of a second.

        Raises:
            ValueError, ArithmeticError: parameters that do not go together.
        """
        self.failure: Exception | None = None
        self._refit_inline = refit_inline
        self._counted: Counter[tuple[str, str]] = Counter()
        self.configure_hull(hull_params or hull.Params())
        self.configure_attitude(attitude_params or fusion.Params())
        self.configure_crane(crane_params or geometry.Params())
        self.configure_reference_mru(reference_mru_params or reference_mru.Params())

    def configure_hull(self, params: hull.Params) -> None:
        """Start the hull stage with these parameters, or end it."""
        self._hull_params = params
        self.hull = HullStage(params, self._refit_inline) if params.enabled else None

    def configure_attitude(self, params: fusion.Params) -> None:
        """Start the attitude stage with these parameters, or end it."""
        self._attitude_params = params
        self.attitude = AttitudeStage(params) if params.enabled else None

    def configure_crane(self, params: geometry.Params) -> None:
        """Have a crane of these measures, or none."""
        self._crane_params = params
        self._crane = CraneEstimator(params) if params.is_there else None

    def configure_reference_mru(self, params: reference_mru.Params) -> None:
        """Compare with an existing MRU, if one is read, by these parameters."""
        self._reference_mru_params = params
        self._reference_mru = ReferenceMru(params)

    # --- input -------------------------------------------------------------------------------------------------------

    def push(self, sample: ImuSample | RatesSample | CraftSample | CraneSample | MruSample) -> None:
        """Take what may concern a stage."""
        if isinstance(sample, MruSample):
            with self._guarded("reference_mru"):
                self._reference_mru.push(sample)
            return
        if isinstance(sample, CraneSample):
            if self._crane is not None:
                with self._guarded("crane"):
                    self._crane.push(sample)
            return
        if isinstance(sample, CraftSample):
            if self.attitude is not None:
                with self._guarded("attitude"):
                    self.attitude.push(sample)
        elif self.hull is not None and sample.fault is Fault.NONE:
            with self._guarded("hull"):
                self.hull.push(sample)

    def push_frame(self, frame: MotionFrame) -> None:
        """Take our own motion; what comes of it is in the next frame."""
        if self._reference_mru.is_awake:
            with self._guarded("reference_mru"):
                self._reference_mru.push_frame(frame)
        if self.attitude is not None:
            with self._guarded("attitude"):
                self.attitude.push_frame(frame)

    def accept(self, result: RefitResult | None) -> bool:
        """Take a refit that was computed elsewhere; False: it was of no use."""
        if self.hull is not None:
            with self._guarded("hull"):
                return self.hull.accept(result)
        return False

    def restore_hull(self, remembered: SavedHull, age_s: float) -> None:
        """Begin with the deformation that an earlier run has found, see :meth:`HullDeformation.restore`."""
        if self.hull is not None:
            with self._guarded("hull"):
                self.hull.restore(remembered, age_s)

    # --- output ------------------------------------------------------------------------------------------------------

    def saved_hull(self) -> SavedHull | None:
        """What a restart shall remember of the hull."""
        if self.hull is not None:
            with self._guarded("hull"):
                return self.hull.saved()
        return None

    @property
    def due_refit(self) -> RefitJob | None:
        """Of the hull, to be computed elsewhere; None: nothing is due."""
        return None if self.hull is None else self.hull.due_refit

    @property
    def angles(self) -> HullAngles | None:
        """The newest of the hull."""
        return None if self.hull is None else self.hull.angles

    @property
    def motion(self) -> CraftMotion | None:
        """The newest of the craft."""
        return None if self.attitude is None else self.attitude.motion

    @property
    def reference_mru(self) -> MruComparison | None:
        """The newest comparison with an existing MRU."""
        return self._reference_mru.comparison

    @property
    def crane(self) -> Crane | None:
        """How the crane base stands; None while it is not known."""
        return None if self.hull is None else self.hull.crane

    def crane_attitude(self, roll_rad: float, pitch_rad: float, yaw_rad: float) -> tuple[float, float, float]:
        """Of the crane base, from the midships one; nan while it is not known."""
        if self.hull is not None:
            with self._guarded("hull"):
                return self.hull.crane_attitude(roll_rad, pitch_rad, yaw_rad)
        return UNKNOWN

    # --- the moving crane --------------------------------------------------------------------------------------------

    @property
    def crane_is_on_base(self) -> bool:
        """Whether its geometry is given from the crane base, along the axes of the second IMU."""
        return self._crane_params.frame == "crane"

    def crane_worth(self, t_s: float, *, hook: bool) -> Worth:
        """What its tip, or its hook, is worth at ``t_s``."""
        if self._crane is None:
            return NO_CRANE
        with self._guarded("crane"):
            return self._crane.worth(t_s, hook=hook)
        return FAILED

    def crane_places(self, t_s: float, offsets_m: Sequence[tuple[Vector, bool]]) -> tuple[Place, ...]:
        """Where points of it are, see :meth:`CraneEstimator.places`; none when that is not known at all."""
        if self._crane is not None:
            with self._guarded("crane"):
                return self._crane.places(t_s, offsets_m)
        return ()

    # --- what befell them --------------------------------------------------------------------------------------------

    @property
    def resets(self) -> Counter[tuple[str, str]]:
        """By (filter, reason); an exception's reason is its name."""
        return self._counted + self._resets("hull") + self._resets("attitude") + self._crane_resets()

    def _resets(self, name: str) -> Counter[tuple[str, str]]:
        """Of the stage that runs."""
        stage = self.hull if name == "hull" else self.attitude
        return Counter({(name, str(reason)): count for reason, count in (stage.resets if stage else {}).items()})

    def _crane_resets(self) -> Counter[tuple[str, str]]:
        return Counter() if self._crane is None else self._crane.resets

    @contextmanager
    def _guarded(self, name: str) -> Iterator[None]:
        """The one place where a stage may fail."""
        try:
            yield
        except Exception as error:  # noqa: BLE001  # whatever befalls a stage, the heave goes on
            self.failure = error
            if name != "reference_mru":  # It counts none of its own.
                self._counted += self._crane_resets() if name == "crane" else self._resets(name)
            self._counted[name, type(error).__name__] += 1
            if name == "hull":
                self.configure_hull(self._hull_params)
            elif name == "crane":
                self.configure_crane(self._crane_params)
            elif name == "reference_mru":
                self.configure_reference_mru(self._reference_mru_params)
            else:
                self.configure_attitude(self._attitude_params)
