"""The command `hil`, and `python -m hil`: what takes turns with nodes is first put where they will be."""

import sys

from hil.addresses import restart_at_fixed_addresses


def main() -> None:
    """Start again, if need be, before anything is imported that takes a while; then be the command line."""
    if sys.argv[1:2] in (["run"], ["bus"], ["node"]):
        restart_at_fixed_addresses()
    from hil import cli

    cli.main()


if __name__ == "__main__":
    main()
