# Enter the bench's environment:  . ./env.sh
# Works in bash and zsh; sets nothing that outlives the shell.
_mrd_root=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")" && pwd)
if [ ! -f "$_mrd_root/install/setup.bash" ]; then
    echo "The bench is not built yet; run: make build" >&2
else
    . "$_mrd_root/.venv/bin/activate"
    if [ -n "${ZSH_VERSION:-}" ]; then . "$_mrd_root/install/setup.zsh"; else . "$_mrd_root/install/setup.bash"; fi
    # Where ROS came from the Python index, the environment itself is the underlay that holds the ament index.
    [ -d "$_mrd_root/.venv/share/rclpy" ] && export AMENT_PREFIX_PATH="$AMENT_PREFIX_PATH:$_mrd_root/.venv"
    # `ros2 run` stands in for the real command only where there is none.
    command -v ros2 >/dev/null 2>&1 || export PATH="$PATH:$_mrd_root/setup/bin"
    # A bench moves a machine: nobody else on the network should find its topics.
    export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
    export MRD_BENCH="${MRD_BENCH:-$_mrd_root/config/bench.yaml}"
    export MRD_DATA="${MRD_DATA:-$_mrd_root/../shared/data}"
fi
unset _mrd_root
