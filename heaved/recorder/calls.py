"""Records that go with calls into the pipeline which are no polls."""

from __future__ import annotations

import msgspec

from heaved.estimation.heave.saved_state import SavedState


class Restored(msgspec.Struct, frozen=True, kw_only=True):
    """What an earlier run had learned, and its age in seconds (nan: not known)."""

    state: SavedState
    age_s: float
