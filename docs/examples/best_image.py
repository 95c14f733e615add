"""The best image of a component under one light, with the standard library: python best_image.py U7 left U7.png"""

import json
import os
import sys
import urllib.parse
import urllib.request
from pathlib import Path

ref, light, file = sys.argv[1:]
runs = os.environ.get("VAOI_STATION", "http://127.0.0.1:8350") + "/api/v1/runs"
run = json.load(urllib.request.urlopen(f"{runs}/latest"))["id"]
address = f"{runs}/{run}/components/{urllib.parse.quote(ref)}/images/0?{urllib.parse.urlencode({'light': light})}"
Path(file).write_bytes(urllib.request.urlopen(address).read())
