"""`python -m svc_ros` does what the command `svc_ros` does."""

from svc_ros.cli.main import main

if __name__ == "__main__":
    main()
