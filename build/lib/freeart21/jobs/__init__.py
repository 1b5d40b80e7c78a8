"""Many jobs: a list in a file, a marker a finished job, and executors that can be exchanged.

A folder of jobs holds `jobs.json`, results wherever the jobs put them, and `.jobs/`: what each job said (statistics,
its two streams) and, written last, a marker when it is finished. What has a marker is skipped, what lacks one is done
anew, so a run that was killed goes on. Where a job runs (this machine, Ray, SLURM) changes none of its bytes.

A jobs file names commands that will be run: it is a program, to be trusted as one.
"""

from freeart21.jobs.executors import EXECUTORS, Executor
from freeart21.jobs.job import Job, read_jobs, write_jobs
from freeart21.jobs.run import ATTEMPTS, Failed, Report, run_jobs

__all__ = ["ATTEMPTS", "EXECUTORS", "Executor", "Failed", "Job", "Report", "read_jobs", "run_jobs", "write_jobs"]
