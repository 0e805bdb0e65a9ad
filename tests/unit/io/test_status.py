"""A status is data: it goes through JSON, and the same status is one key of a dictionary."""

from calib.io.config_change import pipeline_change
from calib.io.status import Status, failure_status

CHANGE = pipeline_change("mocap.unit", "mm")


def test_a_status_with_a_change_of_the_config_is_a_key_as_one_without():
    status = failure_status("no target", change=CHANGE)
    again = Status.from_dict(status.to_dict())
    assert {status: 1}[again] == 1
    assert failure_status("no target") not in {status: 1}
