"""``python -m gray_box_observer.identify``: the command without ROS's tools."""

from gray_box_observer.identify.command import main

if __name__ == '__main__':
    raise SystemExit(main())
