# Enter the bench's environment, in bash or zsh:  . ./env.sh
# Sets nothing that outlives the shell; sourcing it again changes nothing.
if [ -n "${BASH_VERSION:-}" ]; then _mrd_root=${BASH_SOURCE[0]}; else _mrd_root=$0; fi
_mrd_root=$(cd "$(dirname "$_mrd_root")" && pwd)
if [ -z "${BASH_VERSION:-}${ZSH_VERSION:-}" ]; then
    echo "env.sh: needs bash or zsh" >&2
elif [ ! -f "$_mrd_root/install/setup.bash" ]; then
    echo "env.sh: the bench is not built yet; run: make build" >&2
else
    [ ! -f "$_mrd_root/.venv/bin/activate" ] || . "$_mrd_root/.venv/bin/activate"
    if [ -n "${ZSH_VERSION:-}" ]; then . "$_mrd_root/install/setup.zsh"; else . "$_mrd_root/install/setup.bash"; fi
    # Where ROS came as Python wheels, .venv is the underlay that holds the ament index.
    case ":$AMENT_PREFIX_PATH:" in
        *":$_mrd_root/.venv:"*) ;;
        *) [ ! -d "$_mrd_root/.venv/share/rclpy" ] || export AMENT_PREFIX_PATH="$AMENT_PREFIX_PATH:$_mrd_root/.venv" ;;
    esac
    # `ros2 run` stands in for the real command only where there is none.
    command -v ros2 >/dev/null 2>&1 || export PATH="$PATH:$_mrd_root/setup/bin"
    # The tools that need no ROS are also there as `mrd NAME`.
    case ":$PATH:" in *":$_mrd_root/install/mrd_cli/"*) ;; *) export PATH="$PATH:$_mrd_root/install/mrd_cli/lib/mrd_cli" ;; esac
fi
unset _mrd_root
