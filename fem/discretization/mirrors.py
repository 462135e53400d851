"""The mirrors of `fem.mirrors`, until all users have moved."""

from fem.mirrors import *  # noqa: F403
from fem.mirrors import ON_PLANE, QUARTER  # noqa: F401
