"""``python -m gray_box_observer.identify``: the command without ROS's tools, and just the same."""

from gray_box_observer.executables import identify

if __name__ == '__main__':
    raise SystemExit(identify())
