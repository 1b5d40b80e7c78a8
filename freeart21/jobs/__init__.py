"""Batches of jobs: a list in a file, a marker file per finished job, and interchangeable executors.

A folder of jobs holds `jobs.json`, the results of the jobs, and `.jobs/` with each job's statistics, output streams
and, written last, its marker. Jobs with a marker are skipped, so that a killed run can resume. Where a job runs (this
machine, Ray, SLURM) does not change its results.

A jobs file names commands that will be run: trust it like a program.
"""

from freeart21.jobs.executors import EXECUTORS, Executor
from freeart21.jobs.job import Job, read_jobs, write_jobs
from freeart21.jobs.run import ATTEMPTS, Failed, Report, run_jobs

__all__ = ["ATTEMPTS", "EXECUTORS", "Executor", "Failed", "Job", "Report", "read_jobs", "run_jobs", "write_jobs"]
