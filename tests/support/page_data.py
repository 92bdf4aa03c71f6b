"""The data that a page carries."""

import json
import re


def page_data(text: str, identifier: str = "report-data") -> dict:
    """The data of a report, or of another page whose block of data has this identifier."""
    block = re.search(rf'<script type="application/json" id="{identifier}">(.*?)</script>', text, re.S)
    assert block
    return json.loads(block[1])
