"""The process of a `worker.Worker`."""

from abfm.workers.process import Requests
from abfm.workers.server import Server

if __name__ == "__main__":
    Server(Requests()).run()
