"""For Python processes in an emulated machine: python-can imports asammdf, and with it pandas, wherever they are.

They come with the extra `mf4`, which nothing on a SocketCAN bus needs, and cost each process 15 s there.
"""

import sys

sys.modules["asammdf"] = None  # type: ignore[assignment]  # "import asammdf" now says that it is not installed
