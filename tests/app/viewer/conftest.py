"""What all tests of the viewer share: it does not rest between what it does."""

from collections.abc import Iterator

import pytest

from app.viewer.features import links
from app.viewer.features.pair import tab as pair_module
from app.viewer.features.params import terrain


@pytest.fixture(autouse=True, scope="module")
def no_rests() -> Iterator[None]:
    """Begin at once what waits for a person's hand or browser, because whoever tests waits too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(links, "PAUSE", 0.0)
        patch.setattr(pair_module, "BEFORE_FIT", 0.0)
        patch.setattr(terrain, "REST", 0.0)
        yield
