"""Jobs in parallel: one pool of workers, in processes of this machine or on Ray."""
