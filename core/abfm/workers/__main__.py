"""Entry point of the subprocess of a `worker.Worker`."""

from abfm.workers.worker import Server

if __name__ == "__main__":
    Server().run()
