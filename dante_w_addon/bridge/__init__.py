"""The way to the backend and back: scene folder out, process, result in; also the command without a window."""
