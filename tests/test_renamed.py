"""Names of earlier versions: each raises an error that has the new name."""

from __future__ import annotations

import pytest

from eos_pin.errors import EosError, OldNameError, Renamed, renamed


class Arm:
    """Something with an old attribute."""

    length = 1.0
    size = Renamed("length")


def test_renamed_attribute_raises_on_the_class_and_on_its_instances():
    for owner in (Arm, Arm()):
        with pytest.raises(OldNameError, match=r"^Arm\.size was renamed: use length$"):
            _ = owner.size
        assert not hasattr(owner, "size")
    with pytest.raises(OldNameError, match="use length"):
        Arm().size = 2.0
    assert issubclass(OldNameError, EosError)


def test_renamed_argument_raises_and_new_ones_pass():
    @renamed(rate="record_rate")
    def run(record_rate=1.0):
        """Docstring."""
        return record_rate

    @renamed(margin="distance")
    class Law:
        def __init__(self, distance=0.1):
            self.distance = distance

    assert (run(), run(2.0), run(record_rate=3.0), run.__doc__) == (1.0, 2.0, 3.0, "Docstring.")
    assert (Law().distance, Law(distance=2.0).distance) == (0.1, 2.0)
    with pytest.raises(OldNameError, match="the argument 'rate' of run was renamed: use 'record_rate'"):
        run(rate=2.0)
    with pytest.raises(OldNameError, match="the argument 'margin' of Law was renamed: use 'distance'"):
        Law(margin=2.0)
    with pytest.raises(TypeError, match="unexpected"):
        run(speed=1.0)
