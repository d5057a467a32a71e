"""The robot in continuous time, integrated by Drake with error control."""
