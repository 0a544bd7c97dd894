"""Other tools on the same log: small programs that run in an environment of their own (`make peers`), and import nothing of ours."""
