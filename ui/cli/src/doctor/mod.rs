//! `trocar doctor`: checks what limits the rates on this machine, or the path to a host, and how to fix it.

mod network;
mod path_findings;

use std::net::{Ipv4Addr, TcpListener, UdpSocket};
use std::path::Path;

use rustix::process::{Resource, getrlimit};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use rustix::time::clock_gettime;
use serde::Serialize;
use trocar::summary::{Exit, Machine, SCHEMA};
use trocar_kernel::runtime::sched;

use crate::args::DoctorArgs;
use crate::failure::Failure;
use crate::output;
use crate::report::short;

/// Ticks of the bare loop that measures the timer floor.
const TICKS: usize = 1_000;
/// Period of that loop \[ns\].
const PERIOD_NS: i64 = 1_000_000;
/// Above this p99 lateness of a bare loop, 1 kHz is not kept \[µs\].
const FLOOR_P99_US: f64 = 250.0;

/// The status of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    /// Good.
    Ok,
    /// It works, but with limits.
    Warn,
    /// It does not work.
    Fail,
    /// It could not be looked at, because of what failed before.
    Skip,
}

/// One check.
#[derive(Clone, Debug, Serialize)]
struct Check {
    name: &'static str,
    status: Status,
    /// The finding.
    found: String,
    /// The remedy; null when none is needed.
    mend: Option<String>,
}

impl Check {
    fn ok(name: &'static str, found: String) -> Self {
        Self { name, status: Status::Ok, found, mend: None }
    }
    fn warn(name: &'static str, found: String, mend: &str) -> Self {
        Self { name, status: Status::Warn, found, mend: Some(mend.to_owned()) }
    }
    fn fail(name: &'static str, found: String, mend: &str) -> Self {
        Self { name, status: Status::Fail, found, mend: Some(mend.to_owned()) }
    }
    fn skip(name: &'static str, found: &str) -> Self {
        Self { name, status: Status::Skip, found: found.to_owned(), mend: None }
    }
}

/// Runs all checks and prints them.
pub fn doctor(args: &DoctorArgs) -> Result<Exit, Failure> {
    let machine = machine();
    let checks = match &args.ticket_file {
        Some(file) => network::path(file, args.insecure, args.json)?,
        None => of_machine(&machine),
    };
    if args.json {
        let object = serde_json::json!({ "schema": SCHEMA, "machine": machine, "checks": checks });
        output::print_json(&object)?;
    } else {
        output::print_text(&text(&checks))?;
    }
    let failed = checks.iter().any(|check| check.status == Status::Fail);
    Ok(if failed { Exit::Failed } else { Exit::Ok })
}

fn of_machine(machine: &Machine) -> Vec<Check> {
    vec![
        cores(machine),
        governor(machine),
        timer(),
        real_time(),
        locked_memory(),
        gpu(),
        port("UDP port", || UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|socket| socket.local_addr())),
        port("TCP port", || {
            TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).and_then(|socket| socket.local_addr())
        }),
    ]
}

fn text(checks: &[Check]) -> String {
    let mut lines = Vec::new();
    for check in checks {
        let mark = match check.status {
            Status::Ok => console::style("ok  ").green(),
            Status::Warn => console::style("warn").yellow(),
            Status::Fail => console::style("FAIL").red().bold(),
            Status::Skip => console::style("–   ").dim(),
        };
        lines.push(format!("{mark}  {:<20} {}", check.name, check.found));
        lines.extend(check.mend.iter().map(|mend| format!("      {:<20} → {mend}", "")));
    }
    lines.join("\n")
}

/// The machine, as bench and doctor describe it.
pub fn machine() -> Machine {
    let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = cpuinfo
        .lines()
        .find_map(|line| line.strip_prefix("model name").or_else(|| line.strip_prefix("Model")))
        .map(|rest| rest.trim_start_matches([' ', '\t', ':']).trim().to_owned());
    let governor = std::fs::read_to_string("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").ok();
    Machine {
        cpu: model.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
        cores: std::thread::available_parallelism().map_or(1, |cores| cores.get() as u32),
        governor: governor.map(|governor| governor.trim().to_owned()),
        fifo: sched::probe().fifo,
    }
}

fn cores(machine: &Machine) -> Check {
    let found = format!("{} × {}", machine.cores, machine.cpu);
    if machine.cores >= 2 {
        Check::ok("processor", found)
    } else {
        Check::warn("processor", found, "two cores or more keep two hands at 1 kHz beside the physics")
    }
}

fn governor(machine: &Machine) -> Check {
    match machine.governor.as_deref() {
        None => Check::ok("frequency governor", "not told by this system".to_owned()),
        Some("performance") => Check::ok("frequency governor", "performance".to_owned()),
        Some(other) => Check::warn(
            "frequency governor",
            other.to_owned(),
            "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
        ),
    }
}

/// Lateness of a bare 1 kHz loop, with real-time priority where permitted: p50, p99, max \[µs\].
fn timer_floor() -> (f64, f64, f64) {
    let measured = std::thread::spawn(|| {
        sched::promote_current(trocar_kernel::supervision::RuntimeClass::Haptics);
        let now = || {
            let now = clock_gettime(ClockId::Monotonic);
            now.tv_sec * 1_000_000_000 + now.tv_nsec
        };
        let mut due = now() + PERIOD_NS;
        let mut late: Vec<i64> = Vec::with_capacity(TICKS);
        while late.len() < TICKS {
            let at = Timespec { tv_sec: due / 1_000_000_000, tv_nsec: due % 1_000_000_000 };
            // A signal ends the sleep early: that tick counts as on time.
            let _ = clock_nanosleep_absolute(ClockId::Monotonic, &at);
            late.push((now() - due).max(0));
            due += PERIOD_NS;
        }
        late.sort_unstable();
        let at = |share: f64| late[((late.len() - 1) as f64 * share) as usize] as f64 * 1e-3;
        (at(0.5), at(0.99), at(1.0))
    });
    measured.join().unwrap_or((f64::NAN, f64::NAN, f64::NAN))
}

fn timer() -> Check {
    let (p50, p99, max) = timer_floor();
    let found = format!(
        "bare 1 kHz loop wakes late by p50 {} µs, p99 {} µs, at most {} µs",
        short(p50),
        short(p99),
        short(max)
    );
    if p99 <= FLOOR_P99_US {
        Check::ok("timer floor", found)
    } else {
        Check::warn(
            "timer floor",
            found,
            "close other programs; prefer bare metal to a shared virtual machine, a PREEMPT_RT kernel, isolcpus",
        )
    }
}

fn real_time() -> Check {
    let permission = sched::probe();
    if permission.fifo {
        return Check::ok("real-time priority", "granted (SCHED_FIFO)".to_owned());
    }
    Check::warn(
        "real-time priority",
        "refused; everything runs all the same, with more jitter".to_owned(),
        "add '@realtime - rtprio 95' to /etc/security/limits.conf and join that group, or grant CAP_SYS_NICE: \
         sudo setcap cap_sys_nice+ep $(command -v trocar)",
    )
}

fn locked_memory() -> Check {
    const ENOUGH: u64 = 64 << 20;
    match getrlimit(Resource::Memlock).current {
        None => Check::ok("locked memory", "no limit".to_owned()),
        Some(bytes) if bytes >= ENOUGH => Check::ok("locked memory", format!("up to {} MiB", bytes >> 20)),
        Some(bytes) => Check::warn(
            "locked memory",
            format!("up to {} KiB", bytes >> 10),
            "add '@realtime - memlock unlimited' to /etc/security/limits.conf, so that pages can stay resident",
        ),
    }
}

/// Only whether there is a graphics card; none is needed.
fn gpu() -> Check {
    let mut found = Vec::new();
    if let Ok(folder) = std::fs::read_dir("/dev/dri") {
        let names = folder.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned());
        let mut nodes: Vec<String> = names.filter(|name| name.starts_with("renderD")).collect();
        nodes.sort();
        found.extend(nodes.into_iter().map(|name| format!("/dev/dri/{name}")));
    }
    if Path::new("/dev/nvidia0").exists() {
        found.push("/dev/nvidia0".to_owned());
    }
    if found.is_empty() {
        Check::ok("GPU", "none found; none is needed".to_owned())
    } else {
        Check::ok("GPU", found.join(", "))
    }
}

fn port(name: &'static str, bind: impl Fn() -> std::io::Result<std::net::SocketAddr>) -> Check {
    match bind() {
        Ok(address) => Check::ok(name, format!("can be bound on loopback ({address})")),
        Err(error) => Check::fail(
            name,
            format!("cannot be bound on loopback: {error}"),
            "bring the loopback interface up (ip link set lo up), or allow sockets in the sandbox",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_floor_of_a_timer_is_ordered_and_measured() {
        let (p50, p99, max) = timer_floor();
        assert!(p50 >= 0.0 && p50 <= p99 && p99 <= max && max > 0.0, "{p50} {p99} {max}");
    }

    #[test]
    fn whatever_can_be_better_says_how() {
        let machine = Machine { cpu: "x".into(), cores: 1, governor: Some("powersave".into()), fifo: false };
        for check in [cores(&machine), governor(&machine)] {
            assert_eq!(check.status, Status::Warn);
            assert!(check.mend.is_some_and(|mend| !mend.is_empty()));
        }
        let refused = port("UDP port", || Err(std::io::Error::from(std::io::ErrorKind::PermissionDenied)));
        assert_eq!(refused.status, Status::Fail);
        assert!(text(&[refused]).contains("→"));
    }
}
