"""`mlflow server` with one worker, which answers in this process: mlflow would start another that imports the same."""

import os
import sys


def _become(command, extra_env, **_):
    """Do what the command of uvicorn does, to its end."""
    import uvicorn

    os.environ.update(extra_env)
    sys.argv = command[2:]
    uvicorn.main()


def main():
    import mlflow.server
    from mlflow.cli import cli

    mlflow.server._exec_cmd = _become
    sys.argv[0] = "mlflow"
    cli()
