//! Convolution without bias, its input possibly upsampled and beside another.

use burn::backend::flex::FlexTensor;
use burn::tensor::Tensor;
use where2act_kernels::Isa;
use where2act_kernels::conv_train::{
    ConvShape, Part, forward, input_gradient, upsampling_gradient, weight_gradient,
};

use super::TrainingEngine;
use super::function::{Function, apply, flex, sizes, tensor, values, variable};

/// A convolution with a square kernel.
///
/// # Shapes
/// `[b, in, h, w]`, `[out, in, k, k]` -> `[b, out, h', w']`
pub(crate) fn conv(x: &Tensor<4>, weight: &Tensor<4>, stride: usize, padding: usize) -> Option<Tensor<4>> {
    let inputs = [variable(x)?, variable(weight)?];
    let (y, _) = apply(Convolution { stride, padding, kept: None }, inputs)?;
    Some(tensor(y))
}

/// The convolution, stride 1, of `x` doubled by nearest upsampling with `skip` behind its channels; neither the doubled
/// tensor nor the two together are ever written.
///
/// # Shapes
/// `[b, c, h / 2, w / 2]`, `[b, skip, h, w]`, `[out, c + skip, k, k]` -> `[b, out, h, w]`
pub(crate) fn conv_upsampled(
    x: &Tensor<4>,
    skip: &Tensor<4>,
    weight: &Tensor<4>,
    padding: usize,
) -> Option<Tensor<4>> {
    let inputs = [variable(x)?, variable(skip)?, variable(weight)?];
    let (y, _) = apply(Upsampled { padding, kept: None }, inputs)?;
    Some(tensor(y))
}

/// Why a gradient cannot fail.
const CHECKED: &str = "the forward pass has checked the sizes";

/// The input as it was, the weight, the sizes, and what to compute gradients with.
type Kept<const N: usize> = Option<([FlexTensor; N], FlexTensor, ConvShape, Isa)>;

#[derive(Clone, Debug)]
struct Convolution {
    stride: usize,
    padding: usize,
    kept: Kept<1>,
}

impl Function<2> for Convolution {
    fn forward(&mut self, [x, weight]: [&FlexTensor; 2]) -> Option<FlexTensor> {
        let [batch, inputs, height, width] = sizes(x)?;
        let [outputs, _, kernel, same] = sizes(weight)?;
        let Self { stride, padding, .. } = *self;
        let shape = ConvShape { batch, inputs, height, width, outputs, kernel, stride, padding };
        let parts = [Part { planes: values(x), channels: inputs, doubled: false }];
        let isa = TrainingEngine::current().isa();
        let y = (kernel == same).then(|| forward(isa, &shape, &parts, values(weight), None).ok())??;
        self.kept = Some(([x.clone()], weight.clone(), shape, isa));
        Some(flex(y, [batch, outputs, shape.out_height(), shape.out_width()]))
    }

    fn backward(&self, gradient: &FlexTensor, wanted: [bool; 2]) -> [Option<FlexTensor>; 2] {
        let ([x], weight, shape, isa) = self.kept.as_ref().expect("forward comes first");
        let dy = values(gradient);
        let dx = wanted[0].then(|| {
            let dx = input_gradient(*isa, shape, dy, values(weight)).expect(CHECKED);
            flex(dx, [shape.batch, shape.inputs, shape.height, shape.width])
        });
        let dw = wanted[1].then(|| {
            let parts = [Part { planes: values(x), channels: shape.inputs, doubled: false }];
            let dw = weight_gradient(*isa, shape, &parts, dy).expect(CHECKED);
            flex(dw, [shape.outputs, shape.inputs, shape.kernel, shape.kernel])
        });
        [dx, dw]
    }
}

#[derive(Clone, Debug)]
struct Upsampled {
    padding: usize,
    kept: Kept<2>,
}

/// The two parts of the input.
fn parts<'a>(x: &'a FlexTensor, skip: &'a FlexTensor, channels: usize, inputs: usize) -> [Part<'a>; 2] {
    [
        Part { planes: values(x), channels, doubled: true },
        Part { planes: values(skip), channels: inputs - channels, doubled: false },
    ]
}

impl Function<3> for Upsampled {
    fn forward(&mut self, [x, skip, weight]: [&FlexTensor; 3]) -> Option<FlexTensor> {
        let [batch, channels, _, _] = sizes(x)?;
        let [_, beside, height, width] = sizes(skip)?;
        let [outputs, _, kernel, same] = sizes(weight)?;
        let inputs = channels + beside;
        let shape =
            ConvShape { batch, inputs, height, width, outputs, kernel, stride: 1, padding: self.padding };
        let parts = parts(x, skip, channels, inputs);
        let isa = TrainingEngine::current().isa();
        let y = (kernel == same).then(|| forward(isa, &shape, &parts, values(weight), None).ok())??;
        self.kept = Some(([x.clone(), skip.clone()], weight.clone(), shape, isa));
        Some(flex(y, [batch, outputs, shape.out_height(), shape.out_width()]))
    }

    fn backward(&self, gradient: &FlexTensor, wanted: [bool; 3]) -> [Option<FlexTensor>; 3] {
        let ([x, skip], weight, shape, isa) = self.kept.as_ref().expect("forward comes first");
        let ConvShape { batch, inputs, height, width, .. } = *shape;
        let [_, channels, _, _] = sizes(x).expect(CHECKED);
        let dy = values(gradient);
        let (mut of_x, mut of_skip) = (None, None);
        if wanted[0] || wanted[1] {
            let all = input_gradient(*isa, shape, dy, values(weight)).expect(CHECKED);
            if wanted[0] {
                let dx =
                    upsampling_gradient(&all, [batch, inputs, height, width], 0, channels).expect(CHECKED);
                of_x = Some(flex(dx, [batch, channels, height / 2, width / 2]));
            }
            if wanted[1] {
                let images = all.chunks_exact(inputs * height * width);
                let behind: Vec<f32> =
                    images.flat_map(|image| &image[channels * height * width..]).copied().collect();
                of_skip = Some(flex(behind, [batch, inputs - channels, height, width]));
            }
        }
        let dw = wanted[2].then(|| {
            let parts = parts(x, skip, channels, inputs);
            let dw = weight_gradient(*isa, shape, &parts, dy).expect(CHECKED);
            flex(dw, [shape.outputs, inputs, shape.kernel, shape.kernel])
        });
        [of_x, of_skip, dw]
    }
}
