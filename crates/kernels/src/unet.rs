//! The U-Net as a sequence of kernels: ResNet-18 down, skips and nearest upsampling up, a linear head per pixel.

use crate::conv::{Add, Conv, Form, Head, Picture, Source, Stem, Weights, Workspace};
use crate::parallel;
use crate::{Blocked, Isa, ShapeError, max_pool};
use std::time::{Duration, Instant};

/// A convolution with batch-norm folded into it.
#[derive(Clone, Debug, Default)]
pub struct Folded {
    /// `[outputs, inputs, k, k]`.
    pub kernel: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

/// Two 3x3 convolutions and a way around them.
#[derive(Clone, Debug)]
pub struct BlockLayers {
    /// The first, which may halve the size.
    pub first: Folded,
    /// The second.
    pub second: Folded,
    /// The 1x1 convolution around both, where size or channels change.
    pub around: Option<Folded>,
}

/// The weights of the whole network, batch-norms folded.
#[derive(Clone, Debug)]
pub struct UNetLayers {
    /// 7x7, stride 2.
    pub stem: Folded,
    /// Two blocks for each of the four levels.
    pub levels: [[BlockLayers; 2]; 4],
    /// Two 3x3 convolutions for each step up; the first sees the upsampled channels, then the skip's.
    pub ups: [[Folded; 2]; 5],
    /// 1x1, to the features of each pixel.
    pub head: Folded,
}

/// One block of the encoder.
struct Block {
    first: Conv,
    second: Conv,
    around: Option<Conv>,
}

/// One step up. The skip has its own convolution, except for the picture, whose channels enter the upsampling
/// one.
struct Up {
    skip: Option<Conv>,
    up: Conv,
    second: Conv,
}

/// The U-Net compiled for one instruction set.
pub struct UNet {
    isa: Isa,
    stem: Stem,
    levels: Vec<[Block; 2]>,
    ups: Vec<Up>,
    head: Head,
}

/// The maps between the layers, reused from call to call.
#[derive(Default)]
pub struct UNetMemory {
    picture: Picture,
    split: Blocked,
    /// What the skips take: after the stem, and after each level.
    down: [Blocked; 5],
    inner: Blocked,
    up: Blocked,
    workspace: Workspace,
    stages: Option<Vec<(&'static str, Duration)>>,
}

/// Sides from which a form pays.
const WINOGRAD4_FROM: usize = 28;
const WINOGRAD2_FROM: usize = 14;
const UP_WINOGRAD_FROM: usize = 14;

/// Images that go through the network together: enough to use each weight several times where the maps are
/// small, few enough to keep the large maps in the cache.
const TOGETHER: usize = 4;

/// The form for a 3x3 convolution of stride 1 on maps of this side.
fn same_size(side: usize) -> Form {
    match side {
        WINOGRAD4_FROM.. => Form::Winograd4,
        WINOGRAD2_FROM.. => Form::Winograd2,
        _ => Form::Direct { size: 3, stride: 1, pad: 1 },
    }
}

/// Compiles layers one by one.
struct Compiler {
    isa: Isa,
}

impl Compiler {
    fn conv(&self, form: Form, sources: &[Source], folded: &Folded) -> Result<Conv, ShapeError> {
        let weights =
            Weights { kernel: &folded.kernel, bias: Some(&folded.bias), outputs: folded.bias.len() };
        Conv::new(self.isa, form, sources, weights)
    }

    /// `side` is that of the block's output.
    fn block(
        &self,
        layers: &BlockLayers,
        inputs: usize,
        stride: usize,
        side: usize,
    ) -> Result<Block, ShapeError> {
        let first = match stride {
            1 => same_size(side),
            _ => Form::Direct { size: 3, stride, pad: 1 },
        };
        let around = Form::Direct { size: 1, stride, pad: 0 };
        let middle = layers.first.bias.len();
        Ok(Block {
            first: self.conv(first, &[Source::Plain(inputs)], &layers.first)?,
            second: self.conv(same_size(side), &[Source::Plain(middle)], &layers.second)?,
            around: match &layers.around {
                Some(layers) => Some(self.conv(around, &[Source::Plain(inputs)], layers)?),
                None => None,
            },
        })
    }

    /// `side` is that of the small maps; `skip` the channels of the skip, or none for the picture.
    fn up(
        &self,
        [first, second]: &[Folded; 2],
        inputs: usize,
        skip: Option<usize>,
        side: usize,
    ) -> Result<Up, ShapeError> {
        let outputs = first.bias.len();
        let (skip, up) = match skip {
            Some(skip) => {
                let form = if side >= UP_WINOGRAD_FROM { Form::UpWinograd } else { Form::UpDirect };
                let row = (inputs + skip) * 9;
                ShapeError::check("weights of a step up", outputs * row, first.kernel.len())?;
                let part = |inputs: std::ops::Range<usize>| {
                    let rows = first.kernel.chunks_exact(row);
                    rows.flat_map(|row| &row[9 * inputs.start..9 * inputs.end]).copied().collect()
                };
                let of_up = Folded { kernel: part(0..inputs), bias: first.bias.clone() };
                let of_skip = Folded { kernel: part(inputs..inputs + skip), bias: vec![0.0; outputs] };
                let skip = self.conv(same_size(2 * side), &[Source::Plain(skip)], &of_skip)?;
                (Some(skip), self.conv(form, &[Source::Plain(inputs)], &of_up)?)
            }
            None => {
                let sources = [Source::Plain(inputs), Source::Split(3)];
                (None, self.conv(Form::UpWinograd, &sources, first)?)
            }
        };
        Ok(Up { skip, up, second: self.conv(same_size(2 * side), &[Source::Plain(outputs)], second)? })
    }
}

impl UNet {
    /// Packs the weights. `side` is that of the pictures to expect: it decides which form each layer takes, not
    /// which pictures are accepted.
    ///
    /// # Errors
    /// When the layers' sizes disagree, or the head's outputs are not a multiple of 16.
    pub fn new(isa: Isa, layers: &UNetLayers, side: usize) -> Result<Self, ShapeError> {
        let compiler = Compiler { isa };
        let stem = &layers.stem;
        let mut channels = stem.bias.len();
        let weights = Weights { kernel: &stem.kernel, bias: Some(&stem.bias), outputs: channels };
        let stem = Stem::new(isa, weights, 3, 7, 2)?;

        let mut skips = vec![channels];
        let mut levels = Vec::new();
        for (i, [one, two]) in layers.levels.iter().enumerate() {
            let (stride, side) = (if i == 0 { 1 } else { 2 }, side >> (i + 2));
            let first = compiler.block(one, channels, stride, side)?;
            channels = one.second.bias.len();
            let second = compiler.block(two, channels, 1, side)?;
            channels = two.second.bias.len();
            skips.push(channels);
            levels.push([first, second]);
        }

        skips.pop();
        let mut ups = Vec::new();
        for (i, layers) in layers.ups.iter().enumerate() {
            ups.push(compiler.up(layers, channels, skips.pop(), side >> (5 - i))?);
            channels = layers[1].bias.len();
        }
        let head = Head::new(isa, &layers.head.kernel, &layers.head.bias, channels)?;
        Ok(Self { isa, stem, levels, ups, head })
    }

    /// The instruction set it was compiled for.
    pub fn isa(&self) -> Isa {
        self.isa
    }

    /// Features of each pixel.
    pub fn features(&self) -> usize {
        self.head.outputs()
    }

    /// Computes the features `[images, height x width, features]` of pictures `[images, 3, height, width]`.
    ///
    /// # Errors
    /// When height or width is no multiple of 32, or a buffer has another length.
    pub fn run(
        &self,
        pictures: &[f32],
        [images, height, width]: [usize; 3],
        features: &mut [f32],
        memory: &mut UNetMemory,
    ) -> Result<(), ShapeError> {
        ShapeError::check("height of the pictures beyond a multiple of 32", 0, height % 32)?;
        ShapeError::check("width of the pictures beyond a multiple of 32", 0, width % 32)?;
        let pixels = height * width;
        ShapeError::check("values of the pictures", images * 3 * pixels, pictures.len())?;
        ShapeError::check("values of the features", images * pixels * self.features(), features.len())?;
        if pixels == 0 {
            return Ok(());
        }
        let mut portions = pictures
            .chunks(TOGETHER * 3 * pixels)
            .zip(features.chunks_mut(TOGETHER * pixels * self.features()));
        parallel::enter(|| {
            portions.try_for_each(|(pictures, features)| {
                let shape = [pictures.len() / (3 * pixels), 3, height, width];
                self.run_together(pictures, shape, features, memory)
            })
        })
    }

    fn run_together(
        &self,
        pictures: &[f32],
        shape: [usize; 4],
        features: &mut [f32],
        memory: &mut UNetMemory,
    ) -> Result<(), ShapeError> {
        let UNetMemory { picture, split, down, inner, up, workspace, stages } = memory;
        let mut clock = Clock { last: Instant::now(), stages };
        picture.fill(pictures, shape, 3)?;
        picture.split(split);
        clock.lap("input");

        self.stem.run(picture, &mut down[0])?;
        clock.lap("stem");
        let [stem, levels @ ..] = &mut *down;
        max_pool(self.isa, stem, &mut levels[0]);
        clock.lap("pool");
        for (i, blocks) in self.levels.iter().enumerate() {
            let (before, rest) = levels.split_at_mut(i);
            let output = &mut rest[0];
            for block in blocks {
                if let Some(around) = &block.around {
                    // Only the first block of a level changes the size: its input is the level before.
                    let input = before.last().unwrap_or(&*stem);
                    block.first.run(&[input], Add::Nothing, true, inner, workspace)?;
                    around.run(&[input], Add::Nothing, false, output, workspace)?;
                } else {
                    block.first.run(&[output], Add::Nothing, true, inner, workspace)?;
                }
                block.second.run(&[inner], Add::Output, true, output, workspace)?;
            }
            clock.lap(["level 1", "level 2", "level 3", "level 4"][i]);
        }

        let [skips @ .., deepest] = &mut *down;
        std::mem::swap(up, deepest);
        for (i, step) in self.ups.iter().enumerate() {
            if let Some(skip) = &step.skip {
                let from = &skips[skips.len() - 1 - i];
                skip.run(&[from], Add::Nothing, false, inner, workspace)?;
                step.up.run(&[up], Add::Output, true, inner, workspace)?;
            } else {
                step.up.run(&[up, split], Add::Nothing, true, inner, workspace)?;
            }
            clock.lap(["up 1", "up 2", "up 3", "up 4", "up 5"][i]);
            if i + 1 < self.ups.len() {
                step.second.run(&[inner], Add::Nothing, true, up, workspace)?;
                clock.lap(["up 1b", "up 2b", "up 3b", "up 4b", ""][i]);
            } else {
                step.second.run_with_head(&[inner], &self.head, features)?;
                clock.lap("up 5b and head");
            }
        }
        Ok(())
    }
}

impl UNetMemory {
    /// From now on, keeps the time of each stage of the last call.
    pub fn keep_times(&mut self) {
        self.stages = Some(Vec::new());
    }

    /// The stages' times since the last time they were taken.
    pub fn take_times(&mut self) -> Vec<(&'static str, Duration)> {
        self.stages.as_mut().map(std::mem::take).unwrap_or_default()
    }
}

/// Times the stages, if anyone wants to know.
struct Clock<'a> {
    last: Instant,
    stages: &'a mut Option<Vec<(&'static str, Duration)>>,
}

impl Clock<'_> {
    fn lap(&mut self, stage: &'static str) {
        if let Some(stages) = self.stages {
            let now = Instant::now();
            stages.push((stage, now - self.last));
            self.last = now;
        }
    }
}
