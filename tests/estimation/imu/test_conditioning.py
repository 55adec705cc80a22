"""Oracle: readings that a gateway serves again, at known times."""

import msgspec
import numpy as np

from heaved.estimation.imu.conditioning import Conditioner
from heaved.samples import Fault, ImuSample


def test_readings_of_before_are_refused_and_spoken_of() -> None:
    rng = np.random.default_rng(3)
    samples = [
        ImuSample(t_s=n / 20.0, ax_mps2=x, ay_mps2=y, az_mps2=9.8 + np.sin(n / 30.0) + z)
        for n, (x, y, z) in enumerate(0.02 * rng.standard_normal((1600, 3)))
    ]
    conditioner = Conditioner()
    faults, remarks = [], []
    for n, sample in enumerate(samples):
        is_old = n >= 1200 and n % 4 == 3
        read = samples[n - 21] if is_old else sample
        found = conditioner.step(msgspec.structs.replace(read, t_s=sample.t_s))
        assert found.fault is (Fault.STALE if is_old else Fault.NONE)
        assert np.isnan(found.sample.az_mps2) == is_old
        faults.append(found.fault)
        remarks.append(found.notes.remarks)
    assert faults.count(Fault.STALE) == 100
    assert not any(remarks[:1200])
    assert any("readings are old ones that come again" in remark for remark in remarks[-1])
