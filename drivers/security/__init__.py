"""Who may speak on the bus across hosts: the rights of the roles, keys for them, and the check before it opens."""
