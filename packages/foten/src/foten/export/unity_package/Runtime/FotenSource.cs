using UnityEngine;

/// <summary>A texture that plays through this object's AudioSource, whose output drives an actuator.</summary>
[RequireComponent(typeof(AudioSource))]
public sealed class FotenSource : MonoBehaviour
{
    [Tooltip("A texture file as .bytes in a folder Resources/Foten, by its name")] public string textureName = "TEXTURE";
    [Tooltip("Full scale for 1 m/s²")] public float gain = 0.02f;
    [Tooltip("mm/s")] public float speed;
    [Tooltip("N")] public float force;

    private readonly object rendering = new object(); // held by the audio thread as it renders, and to change what it renders from
    private Foten.Texture texture;
    private Foten.Renderer renderer;
    private float[] mono = new float[0];

    private void Start()
    {
        var file = Resources.Load<TextAsset>("Foten/" + textureName);
        if (file == null)
        {
            Debug.LogError($"there is no Resources/Foten/{textureName}.bytes");
            return;
        }
        try
        {
            var loaded = new Foten.Texture(file.bytes);
            var made = new Foten.Renderer(loaded, AudioSettings.outputSampleRate, smooth: true);
            lock (rendering) { texture = loaded; renderer = made; }
        }
        catch (Foten.FotenException error)
        {
            Debug.LogError($"{textureName}: {error.Message}");
        }
    }

    private void OnDestroy()
    {
        lock (rendering)
        {
            renderer?.Dispose();
            texture?.Dispose();
            renderer = null;
        }
    }

    // Without the lock: a condition is set while it renders, and what is freed is freed on this thread.
    private void Update() => renderer?.SetCondition(speed, force);

    // On the audio thread.
    private void OnAudioFilterRead(float[] data, int channels)
    {
        int n = data.Length / channels;
        if (mono.Length < n) mono = new float[n];
        lock (rendering)
        {
            if (renderer == null) return;
            renderer.Render(mono, n);
        }
        for (int i = 0; i < n; i++)
            for (int c = 0; c < channels; c++)
                data[i * channels + c] = Mathf.Clamp(gain * mono[i], -1f, 1f);
    }
}
