"""`python -m luxel` is `luxel`."""

from __future__ import annotations

import sys

from luxel.cli import main

sys.exit(main())
