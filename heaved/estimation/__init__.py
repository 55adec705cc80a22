"""Pure estimators: numpy and scipy only; time, bytes and randomness are arguments.

Where to look, in the order in which a sample passes (``heaved/pipeline.py`` wires it):

* what a reading may be: ``bounds`` (what no vessel does), ``conditioning`` (judges every reading first, with
  ``spikes``, ``angle_gate``, ``mounting`` for signs and units, and ``measured_rate`` for a sensor slower than its
  polls), ``intake`` (tilt, missing samples) with ``attitude_error`` (an attitude that leans, or is late; its equations
  in ``attitude_fit``), ``arrivals`` (how often samples come)
* the heave: ``chain``, with the sea observer ``sea`` (``sea_model``, ``sea_fit`` and ``sea_window`` for the spectrum,
  ``sea_filter`` and ``sea_heave`` for the state, ``sea_bridge`` for holes, ``sea_guard`` for steps and bursts,
  ``sea_trust`` and ``sea_trial`` for how far it is believed, ``smoother`` for the delayed heave), or ``heave``, the
  harmonic observer as published
* the laser: ``laser`` and ``reference`` (what it teaches), ``lead``, ``correction``, ``aiding`` (as a measurement)
* roll, pitch and yaw ahead: ``rock_direct`` and ``rock_paced`` (``rock_holes`` where readings are missing), ``rock``,
  as published
* what is published: ``framing`` (one frame), ``quality`` (state and reasons), ``points``, ``quiescence``
* stages of their own: ``hull`` (deformation between two IMUs), ``fusion`` (foil-assisted craft)
"""
