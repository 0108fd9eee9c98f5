//! What many gauges in one mount cost the daemon, beside one: memory, processor time and wake-ups.
//!
//!     cargo bench --bench gauges
//!
//! The gauges are simulated, so that the daemon computes the battery behind each as well; that is part of
//! the figures. `watched` means that somebody reads the uevent of every gauge once a second.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const NUMBERS: &[usize] = &[1, 8, 64];
const SETTLE: Duration = Duration::from_secs(4);
const WINDOW: Duration = Duration::from_secs(12);

/// What a daemon has used up so far.
#[derive(Clone, Copy)]
struct Used {
    cpu_ms: f64,
    switches: u64,
    rss_kib: u64,
    threads: u64,
}

impl Used {
    fn now(pid: u32) -> Self {
        let read = |name: &str| fs::read_to_string(format!("/proc/{pid}/{name}")).expect("the daemon runs");
        let field = |text: &str, name: &str| -> u64 {
            let line = text.lines().find(|line| line.starts_with(name)).expect("a line of status");
            line.split_ascii_whitespace().nth(1).and_then(|word| word.parse().ok()).expect("a number")
        };
        let status = read("status");
        // Nanoseconds on a processor, of each thread.
        let tasks: Vec<PathBuf> = fs::read_dir(format!("/proc/{pid}/task"))
            .expect("the daemon runs")
            .map(|task| task.expect("an entry").path())
            .collect();
        let ran = |task: &PathBuf| -> f64 {
            let text = fs::read_to_string(task.join("schedstat")).unwrap_or_default();
            text.split(' ').next().and_then(|word| word.parse().ok()).unwrap_or(0.0)
        };
        let switched = |task: &PathBuf| {
            let text = fs::read_to_string(task.join("status")).expect("a thread");
            field(&text, "voluntary_ctxt_switches") + field(&text, "nonvoluntary_ctxt_switches")
        };
        Self {
            cpu_ms: tasks.iter().map(ran).sum::<f64>() / 1e6,
            switches: tasks.iter().map(switched).sum(),
            rss_kib: field(&status, "VmRSS:"),
            threads: field(&status, "Threads:"),
        }
    }
}

struct Daemon(Child, PathBuf);

impl Daemon {
    fn new(gauges: usize, poll: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("gaugefs-bench-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let config = folder.join("gauges.toml");
        let text = format!("[mount]\nmountpoint = 'm'\n[defaults]\npoll = {poll}\n")
            + &"[[gauge]]\nsim = 'bq34z100-g1'\n".repeat(gauges);
        fs::write(&config, text).expect("a file");
        let mut command = Command::new(env!("CARGO_BIN_EXE_gaugefs"));
        command.args(["mount", "-f", "--config"]).arg(&config).stderr(Stdio::null());
        let child = command.spawn().expect("gaugefs runs");
        let last = folder.join(format!("m/BAT{}/present", gauges - 1));
        let start = Instant::now();
        while !last.exists() {
            assert!(start.elapsed() < Duration::from_secs(30), "mounted");
            std::thread::sleep(Duration::from_millis(50));
        }
        Self(child, folder)
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = nix::sys::signal::kill(
            nix::unistd::Pid::from_raw(self.0.id() as i32),
            nix::sys::signal::Signal::SIGTERM,
        );
        let _ = self.0.wait();
        let _ = fs::remove_dir_all(&self.1);
    }
}

fn watch(folder: &Path, gauges: usize) {
    for gauge in 0..gauges {
        let path = folder.join(format!("m/BAT{gauge}/uevent"));
        std::hint::black_box(fs::read(path).expect("it reads"));
    }
}

fn main() {
    if fs::File::options().read(true).write(true).open("/dev/fuse").is_err() {
        println!("SKIPPED: /dev/fuse cannot be opened");
        return;
    }
    println!("poll  gauges  watched  threads  RSS MiB   of one  CPU ms/s   of one  switches/s   of one");
    for poll in ["3.0", "0.5"] {
        for watched in [false, true] {
            let mut one = None;
            for &gauges in NUMBERS {
                let daemon = Daemon::new(gauges, poll);
                let pid = daemon.0.id();
                std::thread::sleep(SETTLE);
                let before = Used::now(pid);
                let start = Instant::now();
                while start.elapsed() < WINDOW {
                    if watched {
                        watch(&daemon.1, gauges);
                    }
                    std::thread::sleep(Duration::from_secs(1));
                }
                let (after, seconds) = (Used::now(pid), start.elapsed().as_secs_f64());
                let figures = [
                    after.rss_kib as f64 / 1024.0,
                    (after.cpu_ms - before.cpu_ms) / seconds,
                    (after.switches - before.switches) as f64 / seconds,
                ];
                let first = *one.get_or_insert(figures);
                let [rss, cpu, switches] = figures;
                let [rss_ratio, cpu_ratio, switches_ratio] = [0, 1, 2].map(|at| figures[at] / first[at]);
                println!(
                    "{poll:>4}  {gauges:6}  {:>7}  {:7}  {rss:7.1}  {rss_ratio:7.1}  {cpu:8.2}  {cpu_ratio:7.1}  \
                     {switches:10.1}  {switches_ratio:7.1}",
                    if watched { "yes" } else { "no" },
                    after.threads
                );
            }
        }
    }
}
