"""A stage of the small dataset, once for all tests of sessions; a session of it, and a studio, for each."""

import pytest

from viewer.window.look import Look
from viewer.window.mailbox import Mail
from viewer.window.session import Session
from viewer.window.stage import Stage, Streets

SIZE = (160, 96)


@pytest.fixture(scope="session")
def stage(scene):
    with Stage({"multi-mesh": scene}, capacity=512 << 20) as found:
        yield found


@pytest.fixture(scope="session")
def streets(scene):
    return Streets(scene, scene.dataset.city())


@pytest.fixture
def session(stage, streets):
    found = Session("somebody", stage, streets, Mail(Look(mode="one", budget_ms=None), SIZE))
    yield found
    found.close()
