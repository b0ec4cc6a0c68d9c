"""Scripts that measure speed."""

import resc as resc  # before torch: it sets how torch's threads wait
