//! Time of a physics step and of trials, on the cabinet of boxes. Targets: 20 us a step on one core; 20 faithful or
//! 45 fast trials a second on two.

use std::sync::Arc;
use std::time::Instant;

use where2act_sim::{Batch, Mode, Observer, Scene, object};

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/sapien_cabinet");
const ROUNDS: usize = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let cabinet = Arc::new(object::open(&format!("{FIXTURE}/cabinet.urdf"))?);
    let table = std::fs::read_to_string(format!("{FIXTURE}/trials.tsv"))?;
    let batch = Batch::parse(&table, Arc::clone(&cabinet))?;
    let scene = Scene::new(Arc::clone(&cabinet), cabinet.closed())?.settle()?;

    let step = median(|| {
        let start = Instant::now();
        let mut steps = 0;
        for attempt in batch.attempts().take(30) {
            let mut look = |moment: &where2act_sim::Moment| steps += usize::from(moment.step > 0) * 50;
            let _ = scene.attempt(attempt, Mode::Faithful, Some(Observer { every: 50, look: &mut look }));
        }
        start.elapsed().as_secs_f64() * 1e6 / steps.max(1) as f64
    });
    println!("physics step, hand and cabinet      {step:>8.1} us");
    for (mode, name) in [(Mode::Faithful, "faithful"), (Mode::Fast, "fast")] {
        let rate = median(|| {
            let start = Instant::now();
            let _ = batch.run(mode, true, || ());
            batch.len() as f64 / start.elapsed().as_secs_f64()
        });
        let threads = rayon::current_num_threads();
        println!("{name:<8} trials on {threads} threads         {rate:>8.1} /s");
    }
    Ok(())
}

fn median(mut measure: impl FnMut() -> f64) -> f64 {
    let mut all: Vec<f64> = (0..ROUNDS).map(|_| measure()).collect();
    all.sort_by(f64::total_cmp);
    all[ROUNDS / 2]
}
