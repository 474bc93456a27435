"""mlflow server that `make ui` starts: its bare address opens the training runs, and its pages are of training.

The part of an address after `#` selects a page in the browser and never reaches a server, so a script is added. mlflow
shows a page as one of language models unless the browser remembers another choice.
"""

import json
import os
from collections.abc import Awaitable, Callable

from fastapi import Request, Response
from mlflow import MlflowClient
from mlflow.server.constants import BACKEND_STORE_URI_ENV_VAR
from mlflow.server.fastapi_app import app

from .experiment import SHARED, VIEW, link

# What the browser remembers unless it remembers another choice: pages are of training, and the assistant stays closed.
REMEMBERED = {"mlflow.workflowType_v1": '"machine_learning"', "mlflow.assistant.fab.autoOpenedOnFirstLoad_v1": "true"}


@app.middleware("http")  # type: ignore[untyped-decorator]
async def open_runs(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
    """Redirect the page at the bare address to the training runs."""
    response = await call_next(request)
    if request.url.path != "/" or response.status_code != 200 or (page := _page()) is None:
        return response
    body = b"".join([part async for part in response.body_iterator])  # type: ignore[attr-defined] # it is streamed
    keys = "; ".join(
        f"localStorage.getItem('{key}') || localStorage.setItem('{key}', '{value}')"
        for key, value in REMEMBERED.items()
    )
    script = f"<script>{keys}; location.hash.length > 2 || location.replace({json.dumps(page)})</script>"
    return Response(body.replace(b"<head>", f"<head>{script}".encode(), 1), media_type="text/html")


def _page() -> str | None:
    """Address of the page of training runs; None before `prepare` has made an experiment."""
    client = MlflowClient(os.environ[BACKEND_STORE_URI_ENV_VAR])
    found = [e for e in client.search_experiments() if f"{SHARED}{VIEW}" in e.tags]
    # Names of other experiments begin with the name of the training runs' experiment: lmd, lmd observe.
    return link("", min(found, key=lambda e: len(e.name)).experiment_id) if found else None
