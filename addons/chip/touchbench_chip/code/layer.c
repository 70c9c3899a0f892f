/* Outputs of a layer: weights [outputs][inputs], each row in steps of its own. */
static void layer(const touch_weight_t *weights, const float *step, const float *bias, int outputs, int inputs, const float *x,
                  float *y)
{
    for (int o = 0; o < outputs; o++) {
        float sum = 0;
        for (int i = 0; i < inputs; i++)
            sum += (float)weights[o * inputs + i] * x[i];
        y[o] = sum * step[o] + bias[o];
    }
}
