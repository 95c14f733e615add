"""Reasons stay, troubles pass."""

from __future__ import annotations

from vaoi_station.acquisition.process.messages import Trouble
from vaoi_station.runs.control.reasons import TROUBLE_S, Reasons, sentence
from vaoi_station.runs.states.schemas import Reason


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def test_a_reason_holds_until_it_is_taken_back() -> None:
    clock = Clock()
    reasons, full = Reasons(clock), Reason(code="ring-full", message="full")
    assert reasons.hold(full)
    assert not reasons.hold(full)
    clock.now_s += 100 * TROUBLE_S
    reasons.expire()
    assert reasons.all() == (full,)
    reasons.drop("ring-full")
    reasons.drop("ring-full")
    assert reasons.all() == ()


def test_a_trouble_lasts_as_long_as_it_is_reported() -> None:
    clock = Clock()
    reasons, cable = Reasons(clock), Trouble("device", "camera 1 is silent", "Check its cable.")
    assert reasons.trouble(cable) is not None
    assert reasons.trouble(Trouble("device", "camera 2 is silent", "")) is not None
    clock.now_s += TROUBLE_S
    assert reasons.trouble(cable) is None
    clock.now_s += 1.0
    reasons.expire()
    assert [reason.message for reason in reasons.all()] == ["Camera 1 is silent"]
    reasons.clear()
    assert reasons.all() == ()
    assert reasons.trouble(cable) is not None


def test_of_devices_that_are_opened_again_only_the_last_trouble_is_shown() -> None:
    reasons = Reasons(Clock())
    absent, refused = Trouble("port-absent", "no port", ""), Trouble("setting-refused", "no gain", "")
    assert reasons.trouble(absent) is not None
    reasons.mark_outdated()
    assert reasons.trouble(absent) is None
    reasons.mark_outdated()
    assert [reason.message for reason in reasons.all()] == ["No port"], "it stays until another is reported"
    assert reasons.trouble(refused) is not None
    assert [reason.message for reason in reasons.all()] == ["No gain"]


def test_sentences_begin_with_a_capital_letter_and_names_stay_as_they_are() -> None:
    assert sentence("camera left: is closed.") == "Camera left: is closed."
    for name in ("station.toml: order is 3", "/dev/null cannot be used", "c1: is closed.", "", "Fine."):
        assert sentence(name) == name
