#!/bin/bash
# A Slurm job, from the folder of the clone:  sbatch docker/slurm.sh [CMD…]
#
# Once before, where there is a network (a login node):  docker/enter true
# It makes the private Debian in ~/.cache/variform; compute nodes must see that folder, else set
# ENTER_CACHE, there and here, to a shared one.
#
# Change: ranks, time, memory; --partition and --account if your cluster wants them.
#SBATCH --job-name=variform
#SBATCH --nodes=1
#SBATCH --ntasks=2
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=2G
#SBATCH --time=01:00:00
#SBATCH --output=slurm-%j.out
set -euo pipefail

# Slurm runs a copy of this file from a folder of its own.
cd "${SLURM_SUBMIT_DIR:?this is a job for Slurm: sbatch docker/slurm.sh}"
[ $# -gt 0 ] || set -- python3 -m demos.twist

if [ "${SLURM_JOB_NUM_NODES:-1}" -gt 1 ]; then
    # mpirun would start its daemons on other nodes outside the private Debian. With srun each rank
    # enters by itself; Slurm needs its PMIx plugin for that (srun --mpi=list).
    export OMPI_MCA_btl=${OMPI_MCA_btl:-self,sm,tcp}
    exec srun --mpi=pmix docker/enter "$@"
fi
# Slurm has given the cores; its commands, which mpirun would ask for them, are not inside.
export PRTE_MCA_ras=^slurm PRTE_MCA_plm=^slurm
exec docker/enter mpirun -n "$SLURM_NTASKS" "$@"
