"""What a diagnosis shows first, and whether its corrected arm is one to go on with."""

from calib.claims.of_diagnosis import is_corrected
from calib.report import diagnosis
from tests.calib.report import examples


def test_without_a_measured_noise_the_joint_is_shown_whose_residual_falls_most() -> None:
    data, _ = examples.diagnosis("no_missing_effect")
    data["gap"] |= {"noise_floor": [], "before": [1.0, 1.0, 4.0, 1.0, 1.0, 1.0], "after": [1.0, 0.9, 1.0, 1.0, 1.0, 1.0]}
    assert diagnosis._joints_in_question(data, data["gap"]["joints"]) == [2]


def test_a_corrected_arm_is_one_that_an_effect_of_the_arm_has_changed() -> None:
    data, _ = examples.diagnosis()
    assert is_corrected(data)
    assert not is_corrected(data | {"effects": [data["effects"][0] | {"effect": "external_contact"}]})
    assert not is_corrected(data | {"arm_out": None})
    assert not is_corrected({key: value for key, value in data.items() if key != "arm_out"})
    assert not is_corrected(examples.diagnosis("no_missing_effect")[0])
