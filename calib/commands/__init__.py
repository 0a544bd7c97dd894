"""One file a command: arguments -> one library call -> report -> exit code. `calib.main.COMMANDS` lists them."""
