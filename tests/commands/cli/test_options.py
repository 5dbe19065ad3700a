"""What options may hold."""

import pytest

from snakejax.commands.cli.options import varied
from snakejax.core.errors import InputError


@pytest.mark.parametrize("text", ["D", "D=1:2", "D=1:2:one", "D=2:1:5", "=1:2:3", "D=1:2:1", "D=nan:2:3"])
def test_values_that_are_none_are_refused(text) -> None:
    with pytest.raises(InputError, match="--vary"):
        varied(text)
